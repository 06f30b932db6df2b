"""Run the notebook of examples/ and keep what it puts out: takes a minute, and no Jupyter.

python tools/docs_notebook.py

Each cell is run as Jupyter runs it, as far as the notebook goes: Python in one namespace, the value of the last line
shown as text, or as a picture; what follows `%%bash` by the shell.
"""

import ast
import base64
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

NOTEBOOK = Path(__file__).parents[1] / "examples" / "train_and_compare.ipynb"
SHELL = "%%bash\n"


def code_cells(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    """Its cells with code, in their order."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def run(notebook: dict[str, Any], folder: Path) -> Iterator[list[dict[str, Any]]]:
    """Run the cells in order in a folder, and return the outputs of each.

    Raises:
        CalledProcessError: if a command of the shell fails.
        Exception: whatever a cell raises.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate(code_cells(notebook), 1):
        code = "".join(cell["source"])
        if code.startswith(SHELL):
            yield run_shell(code.removeprefix(SHELL), folder)
        else:
            yield run_python(code, folder, names, number)


def run_shell(script: str, folder: Path) -> list[dict[str, Any]]:
    """Run a script with the programs of this Python: what it says."""
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    variables = {**os.environ, "PATH": programs}
    done = subprocess.run(["bash", "-c", script], cwd=folder, env=variables, capture_output=True, text=True, check=True)
    return [*said("stderr", done.stderr), *said("stdout", done.stdout)]


def run_python(code: str, folder: Path, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Run Python: what it prints, and the value of its last line, if that is an expression."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    value, before = None, Path.cwd()
    os.chdir(folder)
    try:
        with redirect_stdout(io.StringIO()) as printed:
            exec(compile(tree, f"<cell {number}>", "exec"), names)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), f"<cell {number}>", "eval"), names)
    finally:
        os.chdir(before)
    outputs = said("stdout", printed.getvalue())
    if value is not None:
        shown = {"data": data_of(value), "execution_count": number, "metadata": {}, "output_type": "execute_result"}
        outputs.append(shown)
    return outputs


def said(name: str, text: str) -> list[dict[str, Any]]:
    """The output of a stream, if there is any."""
    return [{"name": name, "output_type": "stream", "text": text.splitlines(keepends=True)}] if text else []


def data_of(value: Any) -> dict[str, Any]:
    """What Jupyter shows of a value."""
    if hasattr(value, "_repr_png_"):
        return {"image/png": base64.b64encode(value._repr_png_()).decode() + "\n"}
    return {"text/plain": repr(value).splitlines(keepends=True)}


def main() -> None:
    """Run it and write it with its outputs."""
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    with TemporaryDirectory() as folder:
        for number, outputs in enumerate(run(notebook, Path(folder)), 1):
            code_cells(notebook)[number - 1].update(outputs=outputs, execution_count=number)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
