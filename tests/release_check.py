"""Whether a commit may be tagged and released: ``make release-check`` builds the archives, and then runs this."""

import re
import subprocess
import sys
from pathlib import Path

from baselines import published

ROOT = Path(__file__).parents[1]


def stale_tables(documents):
    """The names of documents whose tables are not those of the published numbers."""
    numbers = published.read()
    for path in documents:
        text = path.read_text("utf-8")
        if text != published.fill_tables(text, numbers):
            yield path.name


def obstacles(root=ROOT):
    """What has to be done before the version of ``_version.py`` may be tagged, a sentence each."""

    def in_file(name, pattern):
        match = re.search(pattern, (root / name).read_text("utf-8"), re.MULTILINE)
        return match[1] if match else None

    def git(*arguments):
        command = ["git", "-C", str(root), *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()  # noqa: S603 - git

    version = in_file("ptne_env/_version.py", r'^__version__ = "(.+)"$')
    date = in_file("CHANGELOG.md", rf"\A(?:(?!^## ).*\n)*## {re.escape(version)} \((\d{{4}}-\d\d-\d\d)\)$")
    cited = [in_file("CITATION.cff", rf"^{key}: (.+)$") for key in ("version", "date-released")]
    tag, tags_here = f"v{version}", git("tag", "--points-at", "HEAD")
    if date is None:
        yield f"CHANGELOG.md: the first heading must be '## {version} (YYYY-MM-DD)', with the day of the release."
    if cited != [version, date]:
        yield f"CITATION.cff: version and date-released must be {version} and {date}, not {cited[0]} and {cited[1]}."
    if git("status", "--porcelain"):
        yield "The working tree has changes that are not committed, or files that git neither tracks nor ignores."
    if tag not in tags_here and tag in git("tag"):
        yield f"The tag {tag} stands at another commit: raise the version in ptne_env/_version.py."
    yield from (
        f"The tag {other} stands at this commit, whose version is {version}." for other in tags_here if other != tag
    )
    for name in published.missing(published.read()):
        yield f"{name} has no published numbers: run `make publish`."
    yield from (
        f"{name}: the tables are not those of the published numbers: run `python -m baselines.publish --tables`."
        for name in stale_tables(published.documents())
    )


if __name__ == "__main__":
    found = list(obstacles())
    print("\n".join(found) or "This commit may be tagged and released.")
    sys.exit(bool(found))
