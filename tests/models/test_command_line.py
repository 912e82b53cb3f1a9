"""How programs end: exit code 2 and one line for bad input, whatever it is."""

import errno
import os
import re
import shlex
import subprocess
import sys

import pytest

from models import command_line
from models.command_line import ROOT, require, require_writable, run
from models.errors import InputError


def end_of(main, arguments=lambda: None):
    with pytest.raises(SystemExit) as ended:
        run(main, arguments)
    return ended.value.code


def raiser(error):
    def main(_):
        raise error

    return main


def test_the_exit_code_is_that_of_main():
    assert end_of(lambda given: given + 1, lambda: 0) == 1


def test_bad_input_is_one_line(capsys):
    assert end_of(raiser(InputError("one\n   two"))) == 2
    assert capsys.readouterr().err == "error: one two\n"


def test_what_would_steer_a_terminal_is_written_out(capsys):
    assert end_of(raiser(InputError("no \x1b[31mred\u202e\x9b2J\x00\r\nfile ü"))) == 2
    assert capsys.readouterr().err == "error: no \\x1b[31mred\\u202e\\x9b2J\\x00 file ü\n"


def test_a_small_stack_is_refused():
    code = "from models.command_line import run\nrun(lambda _: 0, lambda: None)"
    words = f"ulimit -S -s 1024; exec {shlex.quote(sys.executable)} -c {shlex.quote(code)}"
    done = subprocess.run(["bash", "-c", words], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "error: the stack is limited to 1024 kB, too little: raise the limit (ulimit -s 8192)\n"


def test_a_name_that_is_no_text_is_told():
    code = "from models.command_line import run\nrun(lambda _: open('gone/\\udcff'), lambda: None)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == 2
    assert done.stderr == b"error: gone/\\udcff: No such file or directory: choose another name\n"


@pytest.mark.parametrize(
    ("module", "extra"), [("h5py", "train"), ("distributed.client", "sweep"), ("optuna", "analysis")]
)
def test_a_missing_extra_is_named(capsys, module, extra):
    assert end_of(raiser(ModuleNotFoundError("no", name=module))) == 2
    assert capsys.readouterr().err == f"error: this needs {module}: pip install -e '.[{extra}]'\n"


def test_an_extra_that_is_asked_for_is_named(capsys):
    assert end_of(lambda _: require("numpy", "pyarroww", extra="files")) == 2
    assert capsys.readouterr().err == "error: this needs pyarroww: pip install -e '.[files]'\n"


def test_a_missing_module_of_ours_is_a_bug():
    with pytest.raises(ModuleNotFoundError):
        run(raiser(ModuleNotFoundError("no", name="diagrams.wrold")), lambda: None)


def test_an_installation_without_e_is_refused(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(command_line, "ROOT", tmp_path)
    assert end_of(lambda _: 0) == 2
    assert "pip install -e ." in capsys.readouterr().err


def test_a_closed_pipe_is_no_success_of_what_was_not_done(tmp_path):
    """The reader has gone before the work is done: not exit 0."""
    script, done = tmp_path / "program.py", tmp_path / "done"
    script.write_text(
        "import time\nfrom pathlib import Path\nfrom models.command_line import run\n"
        f"def main(_):\n    print('one', flush=True)\n    time.sleep(1)\n    print('two', flush=True)\n"
        f"    Path({str(done)!r}).touch()\n    return 0\nrun(main, lambda: None)\n"
    )
    command = f"bash -c 'set -o pipefail; PYTHONPATH={ROOT} {sys.executable} {script} | head -n 1'"
    ended = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr, done.exists()) == (141, "one\n", "", False)


def test_output_into_a_closed_pipe_ends_quietly():
    code = (
        "from models.command_line import run\n"
        "run(lambda _: [print('x' * 1000) for _ in range(1000)] and 0, lambda: None)"
    )
    done = subprocess.run(
        f'{sys.executable} -c "{code}" | head -c 10', shell=True, capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (done.stdout, done.stderr) == ("x" * 10, "")


@pytest.mark.parametrize("given", [0, 2, None, "words"])
def test_the_parsers_own_exit_is_kept(given):
    def parse():
        sys.exit(given)

    assert end_of(lambda _: 0, parse) == {None: 0, "words": 1}.get(given, given)


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_what_the_parser_says_in_a_frame_is_one_line(encoding):
    code = "import tyro\nfrom models.command_line import run\nrun(lambda _: 0, lambda: tyro.cli(int, args=['x']))"
    surroundings = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=surroundings, capture_output=True, text=True)
    assert done.returncode == 2
    assert re.fullmatch(r"error: (Value error; )?Error parsing [^\n]*: 'x'; [^\n]*; [^\n]*--help\n", done.stderr)
    assert not re.search("---|─|│", done.stderr)


def test_a_file_that_can_be_written_is_left_as_it_is(tmp_path):
    there, new = tmp_path / "there.json", tmp_path / "folder" / "new.json"
    there.write_text("kept")
    require_writable(there)
    require_writable(new)
    assert there.read_text() == "kept"
    assert not [*new.parent.iterdir()]
    for path in (tmp_path, there / "below.json"):
        with pytest.raises(InputError, match="cannot be written"):
            require_writable(path)


def program(text, shell="{}"):
    """How a program ends whose `main` is `text`, in a shell."""
    code = f"from models.command_line import run\ndef main(_):\n    {text}\n    return 0\nrun(main, lambda: None)"
    command = shell.format(f"{shlex.quote(sys.executable)} -c {shlex.quote(code)}")
    surroundings = os.environ | {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    return subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, check=False, env=surroundings
    )  # fmt: skip


def test_a_terminal_without_the_character_shows_another():
    ended = program("print('98.0 \\xb1 0.8')")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "98.0 ? 0.8\n", "")


def test_closed_streams_are_no_file_of_the_user(tmp_path):
    text = f"import sys; file = open({str(tmp_path / 'x')!r}, 'w'); print(file.fileno(), file=file); print('lost')"
    ended = program(text + "; print('lost too', file=sys.stderr)", "{} >&- 2>&-")
    assert ended.returncode == 0
    assert int((tmp_path / "x").read_text()) > 2


def test_an_output_that_is_full_is_said():
    ended = program("print('words')", "{} > /dev/full")
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: the output: No space left on device: make room there")
    assert ended.stderr.count("\n") == 1


def test_standard_error_without_a_reader_ends_quietly():
    ended = program("import sys; [print('x' * 1000, file=sys.stderr) for _ in range(1000)]", "{} 2>&1 | head -c 10")
    assert (ended.stdout, ended.stderr) == ("x" * 10, "")


@pytest.mark.parametrize(
    ("number", "words"),
    [(errno.ENOSPC, "make room there"), (errno.EROFS, "make it writable"), (errno.EFBIG, "ulimit -f"),
     (errno.EMFILE, "ulimit -n")],
)  # fmt: skip
def test_what_the_machine_refuses_is_one_line(capsys, number, words):
    error = OSError(number, "whatever", "a/file")
    error.add_note("rows.jsonl keeps 3 rows")
    assert end_of(raiser(error)) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: a/file: {os.strerror(number)}: ")
    assert words in said
    assert said.endswith("; rows.jsonl keeps 3 rows\n")
    assert said.count("\n") == 1


def test_an_error_of_the_system_that_no_user_can_mend_is_a_bug():
    with pytest.raises(ConnectionRefusedError):
        run(raiser(ConnectionRefusedError(errno.ECONNREFUSED, "no")), lambda: None)


def test_too_little_memory_is_one_line(capsys):
    assert end_of(raiser(MemoryError())) == 2
    assert capsys.readouterr().err.startswith("error: there is not enough memory: free some")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (
            RuntimeError("DefaultCPUAllocator: can't allocate memory: you"),
            "not enough memory: ",
        ),
        (ImportError("onnx_cpp2py_export.so: failed to map segment from shared object"), "not enough memory: "),
        (RuntimeError("can't start new thread"), "no thread can be started: raise the limit of processes (ulimit -u)"),
        (RuntimeError("Resource temporarily unavailable"), "no thread can be started: "),  # Meshcat's
    ],
)
def test_what_others_say_of_the_machine_is_one_line(capsys, error, words):
    assert end_of(raiser(error)) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert words in said
    assert said.count("\n") == 1


def test_another_error_at_run_time_is_a_bug():
    with pytest.raises(RuntimeError, match="another"):
        end_of(raiser(RuntimeError("another")))
