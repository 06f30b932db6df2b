"""Run the code blocks of the documentation, unless an invisible comment states why not: see CONTRIBUTING.md.

All blocks are checked without running; running all is a long test. The blocks of a page share a copy of the checkout,
and its Python blocks share a namespace. One real server and one scripted language model replace those on the pages.
"""

import contextlib
import gc
import io
import json
import sys
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.api.serving import serving
from tests.docs import shell
from tests.docs.pages import PAGES, ROOT, Block, blocks

# The scripted endpoint is that of the tests of language models.
from tests.llm.conftest import scripted_server  # noqa: F401
from tests.llm.scripted_server import script
from tests.tools import reserved_port

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SHELL = ("bash", "sh", "console")
DATA = {"json": json.loads, "toml": tomllib.loads, "yaml": yaml.safe_load}


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[str, None, None]:
    """URL of a server, started on first use."""
    with serving(tmp_path_factory.mktemp("pages") / "data") as running:
        yield running.url


@pytest.fixture
def endpoint(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Base URL of a language model that flies well with any prompt."""
    script(tmp_path.name, {"pilot": "able"})
    return f"{request.getfixturevalue('scripted_server')}/{tmp_path.name}/v1"


def check(block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check a block without running it.

    Raises:
        AssertionError: if something in it does not exist, or no comment states why it is not run.
        SyntaxError, ValueError: if its syntax is invalid.
    """
    if block.output_of:
        shell.check(block.output_of, block.where, monkeypatch)
    elif block.language in SHELL:
        shell.commands_to_run(block)  # raises if a comment skips an unknown command
        for command in shell.commands(block):
            shell.check(command, block.where, monkeypatch)
    elif block.skipped:
        raise AssertionError(f"{block.where}: only commands of a shell can be left out one by one")
    elif block.language == "python":
        shell.check_python(block.text, block.where)
    elif block.language in DATA:
        DATA[block.language](block.text)
    else:
        language = repr(block.language) if block.language else "a bare fence"
        assert block.not_run or block.file, f"{block.where}: say in a comment above why {language} is not run"


@dataclass
class Page:
    """Runs the blocks of one page.

    Attributes:
        folder: Folder in which the blocks run.
        request: Provides servers if the page needs them.
        shown: The commands whose output the page shows, without filters: they run only there.
        names: Namespace of its Python blocks.
    """

    folder: Path
    request: pytest.FixtureRequest
    shown: set[str]
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "__main__"})

    def run(self, block: Block) -> None:
        """Run a block, unless a comment skips it."""
        if block.output_of:
            assert self._shell([block.output_of], block).stdout == block.text, block.where
        elif block.language in SHELL:
            typed = shell.commands_to_run(block)
            if chosen := [command for command in typed if command.partition("#")[0].strip() not in self.shown]:
                self._shell(chosen, block)
        elif block.language == "python" and not block.not_run:
            self._python(block)

    def _shell(self, chosen: list[str], block: Block) -> Any:
        script = shell.script_of(chosen, reserved_port)
        variables = {"DRONE_ENV_DATA": str(self.folder / "data")}
        if any(name in script for name in ("inference.py", "drone-env infer")):
            url = self.request.getfixturevalue("endpoint")
            variables |= {"API_BASE_URL": url, "OPENAI_API_KEY": "sk-of-the-test", "MODEL_NAME": "scripted"}
        done = shell.run(self._addresses(script), self.folder, variables)
        assert done.returncode == 0, f"{block.where}: exit status {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    def _python(self, block: Block) -> None:
        # Empty lines above make the line numbers of tracebacks those of the page.
        code = compile("\n" * block.line + self._addresses(block.text), block.where.partition(":")[0], "exec")
        with contextlib.redirect_stdout(io.StringIO()):
            exec(code, self.names)

    def _addresses(self, text: str) -> str:
        for address in ("http://localhost:8000", "http://127.0.0.1:8000"):
            if address in text:
                text = text.replace(address, self.request.getfixturevalue("server"))
        return text


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_its_code_blocks_are_sound(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for block in blocks(page):
        check(block, monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("page", PAGES, ids=name)
def test_its_code_blocks_run(
    page: Path, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = blocks(page)
    if not found:
        return
    folder = shell.checkout(tmp_path)
    monkeypatch.setenv("DRONE_ENV_DATA", str(folder / "data"))
    monkeypatch.chdir(folder)
    for block in found:
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")
            monkeypatch.syspath_prepend(folder)  # Python blocks find it as well
    run = Page(folder, request, {block.output_of.partition(" | ")[0] for block in found if block.output_of})
    for block in found:
        run.run(block)
    del run
    gc.collect()  # open resources fail this test instead of a later one
