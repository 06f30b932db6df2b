#!/usr/bin/env bash
# Three checks of a Space before it is handed in; see --help.
set -uo pipefail

usage() {
  cat <<'TEXT'
Usage: ./validate-submission.sh URL [DIR]

Checks a submission end to end:
  1. The Space at URL is live: POST URL/reset answers 200.
  2. The container builds from DIR (its Dockerfile, or server/Dockerfile).
  3. `openenv validate` passes in DIR.

  URL   the Space's own address, such as https://USER-NAME.hf.space
  DIR   the repository; the current folder unless given

All three are always run. Exit status: 0 all passed, 1 a check failed, 2 called wrongly.

Environment:
  BUILDER        what builds: docker (default) or podman
  BUILD_TIMEOUT  seconds that the build may take (1800)
  RESET_TIMEOUT  seconds that the Space may take to answer; a sleeping one wakes slowly (120)
TEXT
}

wrong() {
  echo "validate-submission.sh: $1" >&2
  usage >&2
  exit 2
}

case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  '') wrong 'the URL of the Space is missing' ;;
esac
[ "$#" -le 2 ] || wrong "at most two arguments are allowed, got $#"
url=${1%/}
dir=${2:-.}
builder=${BUILDER:-docker}
build_timeout=${BUILD_TIMEOUT:-1800}
reset_timeout=${RESET_TIMEOUT:-120}
[[ $url =~ ^https?://[^/]+ ]] || wrong "the URL must start with https:// or http://, got $1"
[ -d "$dir" ] || wrong "there is no folder $dir"
[[ $builder =~ ^(docker|podman)$ ]] || wrong "BUILDER must be docker or podman, got $builder"
for seconds in "$build_timeout" "$reset_timeout"; do
  [[ $seconds =~ ^[1-9][0-9]*$ ]] || wrong "a timeout is a whole number of seconds, at least 1, got $seconds"
done
command -v curl >/dev/null || wrong 'curl is needed, and is not installed'

scratch=$(mktemp -d) || exit 2
trap 'rm -rf "$scratch"' EXIT
# Ctrl-C ends the whole, not just the check that is running.
trap 'exit 130' INT
trap 'exit 143' TERM
passed=0

pass() { echo "  PASSED: $1"; passed=$((passed + 1)); }
fail() { echo "  FAILED: $1"; }
hint() { echo "  Hint: $1"; }
# Runs a command under a limit, where the system has `timeout` (macOS has none).
limited() {
  local seconds=$1
  shift
  if command -v timeout >/dev/null; then timeout "$seconds" "$@"; else "$@"; fi
}
# Print openenv's output without the checks that it skips, which would hide the one that failed.
without_skipped() {
  local line skipping=''
  while IFS= read -r line || [ -n "$line" ]; do
    case "$line" in
      '  SKIP '*) skipping=yes ;;
      '  '[A-Z]* | [!\ ]*) skipping='' ;;
    esac
    [ -n "$skipping" ] || printf '%s\n' "$line"
  done <"$1"
}
# What openenv reads, and refuses without saying where: everything that is neither a file nor a folder.
refused() {
  find "$dir" \( -name .git -o -name __pycache__ -o -name .venv -o -name .worktrees -o -name outputs \) -prune \
    -o ! -type f ! -type d -print 2>/dev/null
}
end_of() { sed 's/^/  | /' < <(tail -n 20 "$1"); }

check_space() {
  echo "[1/3] Is the Space live? POST $url/reset"
  local status
  status=$(curl --silent --show-error --location --post301 --post302 --max-time "$reset_timeout" \
    --output "$scratch/answer" --write-out '%{http_code}' \
    --request POST --header 'Content-Type: application/json' --data '{}' "$url/reset" 2>"$scratch/error")
  case "$status" in
    200) pass "$url/reset answers 200" ;;
    000)
      fail "no answer: $(tail -n 1 "$scratch/error")"
      hint "open $url in a browser; is the address right, and is the Space running?"
      ;;
    *)
      fail "it answers $status: $(head -c 300 "$scratch/answer" | tr -d '\000' | tr '\n' ' ')"
      case "$status" in
        401 | 403) hint 'the Space is private, or its server asks for a token (DRONE_ENV_TOKEN) or other hosts' ;;
        404) hint 'use the address https://USER-NAME.hf.space, not the page huggingface.co/spaces/USER/NAME' ;;
        5*) hint "the Space is building, asleep or failing: look at its logs, and try again" ;;
      esac
      ;;
  esac
}

check_build() {
  echo "[2/3] Does the container build? $builder build $dir"
  local file=$dir/Dockerfile
  [ -f "$file" ] || file=$dir/server/Dockerfile
  if [ ! -f "$file" ]; then
    fail "there is no Dockerfile in $dir or $dir/server"
  elif ! command -v "$builder" >/dev/null; then
    fail "$builder is not installed"
    hint 'https://docs.docker.com/get-docker, or BUILDER=podman'
  elif ! "$builder" info >"$scratch/info" 2>&1; then
    fail "$builder is installed, but does not work: $(tail -n 1 "$scratch/info")"
    hint 'is its daemon (Docker Desktop, or the service) running, and may you use it?'
  else
    local started=$SECONDS status=0
    limited "$build_timeout" "$builder" build --file "$file" "$dir" >"$scratch/build" 2>&1 || status=$?
    if [ "$status" -eq 0 ]; then
      pass "built in $((SECONDS - started)) s"
    else
      end_of "$scratch/build"
      if [ "$status" -eq 124 ]; then
        fail "the build takes longer than $build_timeout s"
        hint 'BUILD_TIMEOUT=3600 gives it more'
      else
        fail "the build ended with status $status"
        hint "$builder build --file $file $dir"
      fi
    fi
  fi
}

check_openenv() {
  echo "[3/3] Does openenv validate pass in $dir?"
  if ! command -v openenv >/dev/null; then
    fail 'openenv is not installed'
    if [ -x "$dir/.venv/bin/openenv" ]; then
      hint "it is in $dir/.venv: run '. $dir/.venv/bin/activate', and this again"
    else
      hint "pip install 'openenv>=0.10'"
    fi
  elif (cd "$dir" && limited "$build_timeout" openenv validate) >"$scratch/openenv" 2>&1; then
    end_of "$scratch/openenv"
    pass 'openenv validate'
  else
    without_skipped "$scratch/openenv" >"$scratch/looked_at"
    end_of "$scratch/looked_at"
    fail 'openenv validate'
    refused >"$scratch/refused"
    if [ -s "$scratch/refused" ]; then
      hint 'openenv takes no symbolic links, sockets or pipes; remove these, or put files in their place:'
      end_of "$scratch/refused"
    fi
    hint "(cd $dir && openenv validate) shows all of it; --level static needs no Docker, and finds most mistakes"
  fi
}

check_space
check_build
check_openenv

echo
echo '========================================'
if [ "$passed" -eq 3 ]; then
  echo '  All 3/3 checks passed!'
  echo '  Your submission is ready to submit.'
else
  echo "  $passed/3 checks passed."
  echo '  Mend what failed above, and run this again.'
fi
echo '========================================'
[ "$passed" -eq 3 ]
