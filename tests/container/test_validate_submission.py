"""The logic of `validate-submission.sh`, with fake commands; once with a real server and curl."""

import re
import shutil
from pathlib import Path

import pytest

from tests.api.serving import Server
from tests.tools import find_tool, ran

from .commands import ROOT, Commands

SCRIPT = str(ROOT / "validate-submission.sh")
NEEDED = ("cat", "find", "head", "mktemp", "rm", "sed", "tail", "timeout", "tr")
SPACE = "https://user-name.hf.space"
BANNER = """
========================================
  All 3/3 checks passed!
  Your submission is ready to submit.
========================================
"""


CURL = """
while [ "$1" != --output ]; do shift; done
printf 'this is\\0the answer' > "$2"
echo 200
"""


@pytest.fixture
def commands(tmp_path: Path) -> Commands:
    """Fake commands that succeed."""
    made = Commands(tmp_path / "bin", *NEEDED)
    made.add("curl", CURL)
    made.add("docker", 'echo "docker $*"')
    made.add("openenv", 'echo "openenv $* in $PWD"')
    return made


@pytest.mark.feature("P3")
def test_all_three_pass_with_the_real_server(commands: Commands, server: Server) -> None:
    commands.add("curl", f'exec {shutil.which("curl")} "$@"')
    commands.add("docker", 'echo "$*" >> "$HOME/docker.log"')
    commands.add("openenv", 'echo "$* $PWD" >> "$HOME/openenv.log"')
    done = commands.run(SCRIPT, f"{server.url}/", str(ROOT))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(BANNER)
    assert done.stdout.count("PASSED: ") == 3
    assert (commands.folder / "docker.log").read_text().splitlines()[-1] == f"build --file {ROOT}/Dockerfile {ROOT}"
    assert (commands.folder / "openenv.log").read_text() == f"validate {ROOT}\n"


@pytest.mark.parametrize(
    ("command", "script", "said"),
    [
        ("curl", CURL.replace("200", "404"), "FAILED: it answers 404: this isthe answer"),
        ("docker", '[ "$1" = info ] && exit 0; exit 7', "FAILED: the build ended with status 7"),
        ("openenv", 'echo "FAIL static.manifest"; exit 1', "FAILED: openenv validate"),
    ],
)
def test_one_check_that_fails_leaves_the_others_alone(commands: Commands, command: str, script: str, said: str) -> None:
    commands.add(command, script)
    done = commands.run(SCRIPT, SPACE)
    assert done.returncode == 1
    assert said in done.stdout
    assert "  2/3 checks passed." in done.stdout


@pytest.mark.feature("P3")
def test_the_guide_has_the_same_steps_for_powershell() -> None:
    guide = (ROOT / "docs" / "deployment.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```powershell\n(.*?)```", guide, re.DOTALL)
    assert any("Invoke-RestMethod -Method Post" in block and "openenv validate" in block for block in blocks)


def test_the_script_is_clean() -> None:
    done = ran(find_tool("shellcheck"), SCRIPT)
    assert (done.returncode, done.stdout) == (0, "")
