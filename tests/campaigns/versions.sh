#!/usr/bin/env bash
# The suite on other versions than .ci/run's, each in a fresh environment where its Python is found:
#
#   lowest   Python 3.11, with the lowest versions that pyproject.toml admits (lowest.txt)
#   newest   Python 3.13, with the newest that it admits, Drake and numpy among them
#
#     tests/campaigns/versions.sh [PYTEST ARGUMENT ...]     e.g. tests/models tests/systems; else the whole suite
#
# PYTHON311 and PYTHON313 name the interpreters, where they have other names. Below DIR, where that is set, the
# environments stay and are used again. On Linux without a GPU Python 3.13 fetches 3 GB of CUDA with torch.
# Says of each what it is made of, whether it computes to the bit what the first does (same_bits.py),
# and how the suite ended.
# Exit code: 0: both passed; 1: one failed; 3: none failed, but a Python was not found, and what it should run did not.
set -uo pipefail
here="${BASH_SOURCE[0]%/*}"
cd "$here/../.." || exit 1

folder="${DIR:-}"
[ -z "$folder" ] || { mkdir -p "$folder" && rm -f "$folder/bits.json"; }
passed=0 failed=0

run() { # NAME MINOR INTERPRETER CONSTRAINTS ...
  local name="$1" minor="$2" python="$3" environment words
  shift 3
  if ! command -v "$python" >/dev/null || ! "$python" -c "import sys; sys.exit(sys.version_info[:2] != (3, $minor))" 2>/dev/null; then
    echo "$name: Python 3.$minor was not found: nothing was run"
    return
  fi
  if [ -z "$folder" ]; then folder="$(mktemp -d)" && trap 'rm -rf "$folder"' EXIT; fi
  environment="$folder/$name"
  [ -x "$environment/bin/python" ] || "$python" -m venv "$environment"
  echo "$name: installing ..." >&2
  if ! "$environment/bin/pip" install --quiet --disable-pip-version-check --upgrade --editable '.[dev]' "$@" >&2; then
    echo "$name: FAILED, it cannot be installed"
    failed=$((failed + 1))
    return
  fi
  local bits=0 # 1: a golden output is beyond its tolerance
  words="$(PATH="$environment/bin:$PATH" PYTHONPATH="$PWD" "$environment/bin/python" tests/campaigns/same_bits.py "$folder/bits.json")" || bits=1
  # A page's commands and the linters are .ci/run's.
  if PATH="$environment/bin:$PATH" OMP_NUM_THREADS=1 MPLBACKEND=Agg PYTHONPATH="$PWD" \
    "$environment/bin/python" -m pytest -n 2 --dist loadfile -p no:cacheprovider "${chosen[@]}" >&2 && [ "$bits" -eq 0 ]; then
    echo "$name: passed; $words"
    passed=$((passed + 1))
  else
    echo "$name: FAILED; $words"
    failed=$((failed + 1))
  fi
}

chosen=("$@")
run lowest 11 "${PYTHON311:-python3.11}" --constraint tests/campaigns/lowest.txt
run newest 13 "${PYTHON313:-python3.13}"
echo "$passed of 2 passed"
if [ "$failed" -gt 0 ]; then exit 1; fi
[ "$passed" -eq 2 ] || exit 3
