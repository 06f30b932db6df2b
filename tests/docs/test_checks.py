"""What runs the documentation notices what is wrong with it."""

from pathlib import Path

import pytest

from tests.docs.pages import blocks
from tests.docs.test_code_blocks import Page, check

SKIP = "<!-- not run: a test -->\n\n"


@pytest.fixture
def run(tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    """Runs a page that consists of a text."""
    for name in ("checkout", "bin"):
        (tmp_path / name).mkdir()

    def run_page(text: str) -> None:
        page = tmp_path / "page.md"
        page.write_text(text, encoding="utf-8")
        of_page = Page(tmp_path / "checkout", request, monkeypatch)
        for block in blocks(page):
            check(block, monkeypatch)
            of_page.run(block)

    return run_page


@pytest.mark.parametrize(
    "text",
    [
        "```bash\ntrue\n[ 1 = 1 ]   # a comment\nfalse   # exit status 1\n```",
        "```python\na = 1\n```\n\ntext\n\n```python\nassert a == 1\n```",
        "<!-- output of: echo yes -->\n\n```text\nyes\n```",
        "<!-- not run (docker): needs Docker -->\n\n```bash\ndocker run it\ntrue\n```",
        f"{SKIP}```bash\ndrone-env fly --task easy \\\n  --seed 7\n```",
        f"{SKIP}```bash\nmake serve ARGS=x && drone-env train --task easy --episodes 5 > log 2>&1 | tail\n```",
        f"{SKIP}```python\nfrom drone_env.llm.trl_environment import DroneEnvironment\n```",
    ],
)
def test_what_is_right_passes(run, text: str) -> None:
    run(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("```bash\nfalse\n```", "exit status 1"),
        ("```bash\ntrue   # exit status 1\n```", "exit status 1"),
        ("```bash\nfor i in 1 2; do\n```", "syntax error"),
        ("```bash\ncd docs && drone-env fly --speed 5\n```", "does not understand"),
        ("```python\nraise ZeroDivisionError('here')\n```", "here"),
        ("```json\n{\n```", "Expecting"),
        ("```nginx\nserver {}\n```", "say in a comment"),
        ("```\nanything\n```", "a bare fence"),
        ("<!-- output of: echo yes -->\n\n```text\nno\n```", "page.md"),
        ("<!-- not run: it is last -->\n", "no code block follows"),
        ("<!-- not run (docker): why -->\n\n```bash\ntrue\n```", "no command begins with 'docker'"),
        (f"{SKIP}```bash\ndrone-env fly --speed 5\n```", "does not understand"),
        (f"{SKIP}```bash\npython train.py --rate 5\n```", "does not understand"),
        (f"{SKIP}```bash\ntrue && make nothing\n```", "No rule to make target"),
        (f"{SKIP}```bash\npython benchmarks/nothing.py\n```", "there is no benchmarks/nothing.py"),
        (f"{SKIP}```bash\npip install -e '.[nothing]'\n```", "no extra nothing"),
        (f"{SKIP}```python\nfrom drone_env.llm.trl_environment import Nothing\n```", "has no Nothing"),
    ],
)
def test_what_is_wrong_is_noticed(run, text: str, said: str) -> None:
    with pytest.raises((AssertionError, ValueError, SyntaxError, ZeroDivisionError)) as raised:
        run(text)
    assert said in str(raised.value)
