"""The diagram as a picture."""

import itertools
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

from pydrake.systems.framework import Diagram

from models.errors import InputError
from models.files.container import write_bytes, write_text

FORMATS = (".dot", ".svg", ".png")
# The controller and the station's own systems are shown; what is inside Drake's is not.
DEPTH = 2

_NODE = re.compile(r"(?P<id>s\d+) \[shape=none, border=0, label=<\n(?P<table>.*?)\n>\];", re.DOTALL)
_HEAD = re.compile(r"<B>(?P<kind>[^<]*)</B><BR/>\nname=(?P<name>[^\n]*)")
_CELL = re.compile(r'<TD PORT="(?P<port>[uy]\d+)"[^>]*>(?:<FONT[^>]*>)?(?P<label>[^<]*)')
_EDGE = re.compile(r"^(s\d+(?:in|out)?):(\w+):e -> (s\d+(?:in|out)?):(\w+):w", re.MULTILINE)
_ANONYMOUS = re.compile(r"[uy]\d*|Source_\d+_\w+")
_EXPORTED = re.compile(r"(?P<id>s\d+(?:in|out)) \[shape=none, label=<\n(?P<table>.*?)\n>\];", re.DOTALL)
_EXPORTED_CELL = re.compile(r'PORT="(?P<port>\d+)">(?P<label>[^<]*)')


def graph_program() -> str:
    """Graphviz's `dot`, or without it the command of a dependency, beside this Python; InputError without both."""
    dot = shutil.which("dot") or shutil.which("graphviz-pure", path=sysconfig.get_path("scripts"))
    if dot is None:
        raise InputError(
            "there is no program `dot` to draw the graph with: "
            "install Graphviz or the package graphviz-pure (a .dot needs neither)"
        )
    return dot


def save_graph(diagram: Diagram, path: Path) -> None:
    """Writes the graph of `diagram`, left to right, as .dot, .svg or .png.

    Raises InputError for another format, without a program `dot`, and where that fails.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"{path.name} is no format for the graph: choose a name that ends in {', '.join(FORMATS)}")
    text = readable(diagram.GetGraphvizString(max_depth=DEPTH, options={"plant/split": "I/O"}))
    if path.suffix == ".dot":
        write_text(path, text)
        return
    dot = graph_program()
    try:
        drawn = subprocess.run([dot, f"-T{path.suffix[1:]}"], input=text.encode(), check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        words = " ".join((getattr(error, "stderr", b"").decode(errors="replace") or str(error)).split())
        raise InputError(f"{dot} cannot draw {path} ({words}): mend that program, or ask for .dot") from error
    write_bytes(path, drawn.stdout)


def readable(text: str) -> str:
    """Drake's graph with the wired ports alone, each with a name.

    Where Drake numbers an input, that of what it is wired to; an output, its system's.
    """
    edges = _EDGE.findall(text)
    sources = {(target, port): (node, out) for node, out, target, port in edges}
    used = set(sources) | set(sources.values())
    names = {m["id"]: head["name"] for m in _NODE.finditer(text) if (head := _HEAD.search(m["table"]))}
    labels = {
        (m["id"], cell["port"]): cell["label"]
        for pattern, cells in ((_NODE, _CELL), (_EXPORTED, _EXPORTED_CELL))
        for m in pattern.finditer(text)
        for cell in cells.finditer(m["table"])
    }

    def label(node: str, port: str) -> str:
        own = labels[node, port]
        if not _ANONYMOUS.fullmatch(own):
            return own
        return names[node] if port[0] == "y" else label(*sources[node, port])

    def node(match: re.Match) -> str:
        head = _HEAD.search(match["table"])
        if head is None:
            return match[0]
        ports = [cell["port"] for cell in _CELL.finditer(match["table"]) if (match["id"], cell["port"]) in used]
        cells = [
            [f'<TD PORT="{port}" BORDER="1">{label(match["id"], port)}</TD>' for port in ports if port[0] == side]
            for side in "uy"
        ]
        pairs = itertools.zip_longest(*cells, fillvalue='<TD BORDER="0"></TD>')
        rows = "\n".join(f"<TR>{''.join(pair)}</TR>" for pair in pairs)
        title = f'<TR><TD BORDER="1" COLSPAN="2"><B>{head["name"]}</B><BR/>{head["kind"].split(".")[-1]}</TD></TR>'
        table = f'<TABLE BORDER="0" CELLSPACING="0">\n{title}\n{rows}\n</TABLE>'
        return f"{match['id']} [shape=none, border=0, label=<\n{table}\n>];"

    text = _NODE.sub(node, text)
    # Landscape, as large as a page; what is exported and read by nobody stays, in the frames' lists.
    return text.replace(
        "rankdir=LR", 'rankdir=LR\nnodesep=0.15\nranksep=0.5\nsize="16.5,11.7"\ndpi=200\nfontname="Helvetica"', 1
    )
