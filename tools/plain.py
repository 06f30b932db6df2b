"""Find sentences that are hard to read: in docs, docstrings, comments, messages, scripts and the page.

    python tools/plain.py [--list] [PATH ...]

It prints the share of flagged sentences, and exits with status 1 if that is above the limit; `--list` prints each one.
The rules are patterns of translated English: unusual word order, clauses as subjects, programs that speak. They miss
much, so a low share is necessary but not sufficient.
"""

import argparse
import ast
import html
import io
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

LIMIT = 0.015
SUFFIXES = (".md", ".py", ".js", ".html", ".conf", ".sh", ".ci/run", "Dockerfile", "Makefile")
VERBS = "is|are|has|have|was|does|do|may|must|can|goes|comes|takes|counts|holds|needs|wants|will|would|makes"
RULES = {
    "clause as subject": r"^(?:And |But |So )?(?:What|Who|Whoever|Whatever|Which|All that|Nothing that)\b[^,.?]*"
    rf"\b(?:{VERBS})\b(?![^.!]*\?)",
    "clause as object": r"\b(?:of|from|by|with|for|than|about) (?:what|who|whoever|whatever)\b",
    "program that speaks": r"\b(?:says (?:so|who|what|which|why|how|whether)|tells (?:who|what|it|them)|(?:is|are) told"
    r"|asked whether|hears|knows (?:of|nothing))\b",
    "stands": r"\b(?:stands?|lies?) (?:in|on|at|beside|below|above|here|there|as|for|behind|between)\b",
    "who for those who": r"(?:^|[,;:] |\b(?:of|for|by|to|with) )who (?:is|are|has|flies|wants|needs|sends|reads)\b",
    "where for if": r"(?:^|, |; )where (?:it|that|there|they|nothing|none|no) (?:is|are|has|have|was|can|does)\b",
    "inverted order": r"^(?:In it|On it|Of it|Of them|Of these|Of those|Of one|From it|By it|Beside it|To it|Nor"
    r"|So (?:is|are|does))\b",
    "vague person": r"\b(?:nobody|somebody|anybody|oneself|himself|one's own)\b",
    "vague quantity": r"\b(?:so many|so much|as long again|a few at a[ ]time)\b",
}
PATTERNS = {name: re.compile(rule) for name, rule in RULES.items()}


def texts(path: Path) -> Iterator[str]:
    """Yield the texts that people read in a file."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield re.sub(r"```.*?```|<!--.*?-->", "\n\n", source, flags=re.DOTALL)
    elif path.suffix == ".html":
        yield html.unescape(re.sub(r"<(script|style|svg).*?</\1>|<[^>]*>", "\n\n", source, flags=re.DOTALL))
    elif path.suffix == ".js":
        yield from (match[1] or match[2] for match in re.finditer(r"/\*(.*?)\*/|//([^\n]*)", source, re.DOTALL))
        yield from (match[2] for match in re.finditer(r"([\"'`])((?:\\.|(?!\1)[^\\\n])*)\1", source))
    elif path.suffix != ".py":
        yield "\n".join(line.strip().lstrip("#") for line in source.splitlines() if re.match(r"\s*#(?!!)|$", line))
    else:
        # Strings include docstrings, messages, help texts and field descriptions.
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT:
                yield token.string.lstrip("# ")


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text that have more than three words."""
    for part in re.split(r"(?<=[.!?:;])\s+(?=[A-Z`*\"(])|\n\s*\n|\n\s*[-*|#>]\s*|\|", text):
        sentence = " ".join(part.split())
        if len(sentence.split()) > 3:
            yield sentence


def files(paths: list[str]) -> list[Path]:
    """Return the tracked files with texts under these paths."""
    listed = subprocess.run(["git", "ls-files", *paths], capture_output=True, text=True, check=True).stdout.split()
    written = [name for name in listed if "/vendor/" not in name and "/bundle/" not in name]
    return [Path(name) for name in written if name.endswith(SUFFIXES)]


def main() -> int:
    """Print the share of flagged sentences; return 1 if it is above the limit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", default=["."])
    parser.add_argument("--list", action="store_true", help="print each flagged sentence")
    options = parser.parse_args()
    total, flagged = 0, Counter[str]()
    for path in files(options.paths):
        for sentence in (sentence for text in texts(path) for sentence in sentences(text)):
            total += 1
            rule = next((name for name, pattern in PATTERNS.items() if pattern.search(sentence)), None)
            if rule is not None:
                flagged[rule] += 1
                if options.list:
                    print(f"{path}: {rule}: {sentence[:200]}")
    share = flagged.total() / max(1, total)
    print(f"{flagged.total()} of {total} sentences ({share:.2%}, limit {LIMIT:.1%}):", dict(flagged.most_common()))
    return int(share > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
