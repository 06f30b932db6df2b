"""MkDocs hooks: pages of the repository's root, and one for each environment, are part of the site."""

import re
from pathlib import Path
from typing import Any

from docs_environments import FOLDER, site_files, title
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from drone_env.core.tasks import TASKS
from drone_env.envs.registry import load_plugins

ROOT = Path(__file__).parents[1]
OF_THE_ROOT = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "leaderboard/README.md": "leaderboard.md",
}
OTHER_FILE = re.compile(r"\[([^\]]+)\]\(\.\./([^)#]+)\)")
EXAMPLE = re.compile(r"\[([^\]]+)\]\((examples/[^)#]+)\)")
TARGET = re.compile(r"(?<=\]\()([^)#:\s]+)(?=[)#])")


def on_config(config: Any) -> Any:
    """List the pages of the environments below their table."""
    load_plugins()
    (reference,) = (part["Reference"] for part in config.nav if "Reference" in part)
    (listed,) = (part["Environments"] for part in reference if "Environments" in part)
    listed += [{title(task): f"{FOLDER}/{task.short_name}.md"} for task in TASKS.values()]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages, with links relative to their place on the site."""
    for name, page in OF_THE_ROOT.items():
        text = EXAMPLE.sub(_named, (ROOT / name).read_text(encoding="utf-8"))
        files.append(File.generated(config, page, content=TARGET.sub(_from_docs, text)))
    for name, content in site_files().items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links from other pages to those of the root; other files of the repository are named, not linked.

    In the table of environments, each id links to its page, which only the site has.
    """
    if page.file.src_uri.startswith(f"{FOLDER}/"):
        return markdown
    if page.file.src_uri == f"{FOLDER}.md":
        for task in TASKS.values():
            markdown = markdown.replace(f"| `{task.gym_id}` |", f"| [`{task.gym_id}`]({FOLDER}/{task.short_name}.md) |")
    for name, target in OF_THE_ROOT.items():
        markdown = markdown.replace(f"](../{name}", f"]({target}")
    return OTHER_FILE.sub(_named, markdown)


def _named(link: re.Match[str]) -> str:
    if not (ROOT / link[2]).exists():
        raise PluginError(f"there is no {link[2]}, which a page links to")
    return link[1]


def _from_docs(link: re.Match[str]) -> str:
    return OF_THE_ROOT.get(link[1], link[1].removeprefix("../").removeprefix("docs/"))
