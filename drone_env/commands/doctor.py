"""`drone-env doctor`: what is installed, where things go, and whether flights can be flown."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drone_env import __version__
from drone_env.commands.printing import print_json

if TYPE_CHECKING:
    from drone_env.commands.diagnosis import Finding

MARKS = {"ok": "[green]ok[/]", "absent": "[dim]absent[/]", "attention": "[yellow]look[/]", "broken": "[red]broken[/]"}


def doctor(port: int | None = None, host: str | None = None, data: Path | None = None, json: bool = False) -> int:
    """Tell what is installed, where data goes, whether the port is free, and whether the settings are understood.

    Exit status: 0 where flights can be flown, 1 where something is broken: a package that is needed, a shipped network,
    a folder that cannot be written, a setting. An extra that is not installed is absent, and a port that is taken is
    worth a look; neither is broken. Nothing is left behind, and no token is ever printed.

    Example: drone-env doctor --port 9000

    Args:
        port: The port that a server would listen on; DRONE_ENV_PORT or 8000 if nothing is said.
        host: The address that it would listen on; DRONE_ENV_HOST or 127.0.0.1 if nothing is said.
        data: The folder of what is kept; DRONE_ENV_DATA or `data` if nothing is said.
        json: Print JSON instead.
    """
    from drone_env.commands.diagnosis import diagnose  # loads Numba, which other commands should not wait for

    findings = diagnose(port, host, data)
    healthy = all(finding.status != "broken" for finding in findings)
    if json:
        report = {"version": __version__, "healthy": healthy, "findings": [asdict(finding) for finding in findings]}
        print_json(report)
    else:
        _print(findings, healthy)
    return 0 if healthy else 1


def _print(findings: "list[Finding]", healthy: bool) -> None:
    console = Console()
    table = Table(box=box.SIMPLE_HEAD, title=f"drone-env {__version__}", title_justify="left", show_header=False)
    for _ in range(4):
        table.add_column(overflow="fold")
    topic = ""
    for finding in findings:
        shown = "" if finding.topic == topic else finding.topic
        topic = finding.topic
        table.add_row(f"[bold]{shown}[/]", escape(finding.name), MARKS[finding.status], escape(finding.detail))
    console.print(table)
    broken = [finding.name for finding in findings if finding.status == "broken"]
    console.print("Flights can be flown." if healthy else f"[red]Broken:[/] {escape(', '.join(broken))}")
