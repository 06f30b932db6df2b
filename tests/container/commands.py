"""Fake commands on a separate `PATH`."""

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]


class Commands:
    """A folder of commands that is the whole `PATH`.

    Args:
        folder: The folder to create.
        real: Additional commands of the system.
    """

    def __init__(self, folder: Path, *real: str) -> None:
        self.folder = folder
        folder.mkdir()
        for name in ("bash", "sleep", *real):
            found = shutil.which(name)
            assert found is not None, f"these tests need {name}"
            (folder / name).symlink_to(found)

    def add(self, name: str, script: str) -> None:
        """Add a bash script as a command."""
        command = self.folder / name
        command.write_text(f"#!{shutil.which('bash')}\n{script}\n", encoding="utf-8")
        command.chmod(0o755)

    def run(self, *command: str, cwd: Path = ROOT, **variables: str) -> "subprocess.CompletedProcess[str]":
        """Run a command with only these commands on `PATH`."""
        environment = {"PATH": str(self.folder), "HOME": str(self.folder), **variables}
        return subprocess.run(
            command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=60, check=False
        )
