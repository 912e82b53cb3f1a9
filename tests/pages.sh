#!/usr/bin/env bash
# The release check: runs every command of every page, in the order of a reader, in a temporary copy of this folder.
#
#     tests/pages.sh          as written, in a fresh virtual environment (PYTHON chooses the interpreter)
#     tests/pages.sh --here   in the present environment; what installs is left out
#
# Pages after that are run instead of all of them: tests/pages.sh --here diagrams/ANALYSIS.md
# One line a command: how it ended, seconds, page, the command as it was run. Exit code 1 if one of them failed.
# The commands come from the ```sh blocks of the pages themselves. What would take long is run with small sizes: see
# `smaller`. A command that takes more than SLOW seconds although nothing makes it smaller is named at the end.
set -uo pipefail
shopt -s inherit_errexit 2>/dev/null || true
ROOT="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
HERE=""
[ "${1:-}" = --here ] && HERE="$1" && shift
SLOW=60
PAGES=(README.md models/README.md diagrams/RESULTS.md) # in this order: the later take what the earlier make
mapfile -t others < <(cd "$ROOT" && git ls-files '*.md' | grep -vxF "$(printf '%s\n' "${PAGES[@]}")")
PAGES+=("${others[@]}")
[ $# -gt 0 ] && PAGES=("$@")

# What stands in for what, as a sed script (extended regular expressions). The first part is for --here only.
installs() {
  cat <<'SED'
s/python3 -m venv \.venv && \. \.venv\/bin\/activate( && )?//
s/pip install [^&]*(&& )?//
SED
}
smaller() {
  cat <<'SED'
# The suite has its own check, .ci/run; ratios of benchmarks need a machine on which nothing else runs.
s/pytest -n 2 --dist loadfile/pytest tests\/test_pages.py/
s/ --measure//
# Sweeps: one episode of each combination, one training seed, one disturbance for the other detectors.
/sweep\.py/{s/ --episodes [0-9]+//;s/$/ --episodes 1/}
/sweep\.py/s/--training-seeds 0 1 2/--training-seeds 0/
/sweep\.py.*--detector/{/--disturbance/!s/$/ --disturbance none/}
# Training: eight demonstrations (two trained positions), a few updates.
/teach\.py/s/$/ --limit 8/
/training cae/s/$/ --max-images 128/
s/ --steps [0-9]+//
/training rnn/s/$/ --steps 4 --checkpoint-every 2 --validate-every 4/
/training recall/s/$/ --steps 2 --checkpoint-every 1/
s/rnn-(6000|32000)\.onnx/rnn-4.onnx/
# Networks of a few updates finish no task: the calibration takes the shipped ones, and the episode after it.
/pick_place\.py --weights runs\/weights$/s/^/cp models\/weights\/encoder.onnx runs\/weights; /
/calibrate\.py/s/--encoder [^ ]+/--encoder models\/weights\/encoder.onnx --episodes 2 --disturbed 2 --runs 2/
/calibrate\.py/s/--candidates [^ ]+/--candidates models\/weights\/lstm.onnx/
# Nor does a clone of a few: its calibration has to find that out, and it flies under no detector.
/-m tests\.diagrams\.cloned_policy/s/$/ 100/
/calibrate\.py --policy/s/$/ --episodes 1 2>\&1 | grep "no candidate finished"/
/pick_place\.py --policy/{s/--detector knn/--detector never/;s/$/; test $? -le 1/}
/sweep\.py --policy/s/--detector knn never/--detector never/
/iiwa/s/models\/weights\/(encoder|lstm)\.onnx/models\/weights\/iiwa\/\1.onnx/g
/baselines\.py/s/lstm\*\.onnx/lstm.onnx/
/baselines\.py/s/$/ --episodes 2 --disturbed 2 --trials 1 --factors 1 --betas 30 --fit-runs 3/
# The bench: one episode of one fault, too few networks' runs for any figure.
/bench\.py( --|$)/{s/--faults [^-]+/--faults A /;/--faults/!s/$/ --faults A/;s/--episodes [0-9]+/--episodes 1/;s/$/ --fit-runs 3 --calibration-runs 2/}
/bench\.py coverage/s/$/ --runs 4 --calibration-runs 4 --disturbed 1 --deltas 0.5; test $? -le 1/
# Of so few runs too few do their task: what scores them has to find that out.
/bench\.py offline/s/$/ 2>\&1 | grep "of the runs did their task, 8 or more are needed"/
/campaigns\/soak\.py/s/$/ --minutes 1 --count 40/
/campaigns\/stl\.py/s/--count [0-9]+ --episodes [0-9]+/--count 20 --episodes 1/
# Campaigns: hours on free cores, of all programs; the versions need other Pythons.
/tests\/campaigns\//s/--count [0-9]+/--count 1/
/campaigns\/(kills|machine)\.py/s/$/ --targets teach/
s/^tests\/campaigns\/versions\.sh/test -x &/
# The page runs until Ctrl-C.
s/python diagrams\/live\.py/timeout --preserve-status -s INT 20 python diagrams\/live.py --no-open/
# Nobody plays in it: what a person would have left.
s/^python diagrams\/pick_place\.py --scenario outputs\/live\.yaml/mkdir -p outputs; echo "hands: {force: [[40, 0, 20, 0], [50, 0, 0, 0]]}" > outputs\/live.yaml; &/
# Analyses: small samples.
/analysis\.py return/s/$/ --samples 20 --draws 5/
/analysis\.py resume/s/$/ --starts 15 --runs 2/
/analysis\.py linearize/s/--samples 20/--samples 2/
/analysis\.py guard/s/--grid 41 --rays 16/--grid 11 --rays 2/
/analysis\.py falsify/s/$/ --trials 1 --scenes 1/
/analysis\.py defeat/s/--brute .*/--kinds B --population 4 --kept 0.5 --repetitions 2 --brute 2/
SED
}

# The commands of a page, one a line: its ```sh blocks, continued lines joined, comments and empty lines left out.
commands() {
  awk '/^```/ { inside = ($0 == "```sh"); next } inside' "$1" | sed -e ':join' -e '/\\$/{N;s/\\\n */ /;b join' -e '}' |
    sed -E '/^ *(#|$)/d'
}

folder="$(mktemp -d)"
log="$(mktemp)"
trap 'rm -rf "$folder" "$log"' EXIT
cd "$ROOT" && git ls-files -z --cached --others --exclude-standard | while IFS= read -r -d '' file; do
  [ -e "$file" ] && cp --parents "$file" "$folder"
done
cd "$folder" || exit 1
git init -q . # ruff reads .gitignore
export MPLBACKEND=Agg PYTHONPATH="$folder"
if [ "$HERE" = --here ]; then export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"; fi

failed=0
slow=()
for page in "${PAGES[@]}"; do
  while IFS= read -r written <&3; do
    plain="$written"
    if [ "$HERE" = --here ]; then plain="$(sed -E -f <(installs) <<<"$plain")"; fi
    if [ -n "${PYTHON:-}" ]; then plain="${plain/python3 -m venv/$PYTHON -m venv}"; fi
    command="$(sed -E -f <(smaller) <<<"$plain")"
    [ -n "${command// /}" ] || continue
    activate=""
    [ -f .venv/bin/activate ] && activate=". .venv/bin/activate; "
    start=$SECONDS
    bash -c "$activate$command" >"$log" 2>&1 </dev/null
    code=$?
    seconds=$((SECONDS - start))
    word=ok
    if [ "$code" != 0 ]; then word="FAIL $code" failed=$((failed + 1)); fi
    printf '%-7s %4d s  %s: %s\n' "$word" "$seconds" "$page" "$command"
    if [ "$code" != 0 ]; then tail -n 15 "$log" | sed 's/^/    /'; fi
    if [ "$seconds" -gt "$SLOW" ] && [ "$command" = "$plain" ]; then slow+=("$command"); fi
  done 3< <(commands "$page")
done
for command in "${slow[@]}"; do echo "slow, and nothing makes it smaller: $command"; done
echo "$failed commands failed"
[ "$failed" = 0 ]
