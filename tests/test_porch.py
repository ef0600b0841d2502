"""The files at the door agree: workflows, hooks, forms of issues, citation, versions and the check of a release."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import release_check
import yaml

import ptne_env

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")


def parsed(name):
    return yaml.safe_load((ROOT / name).read_text("utf-8"))


def jobs():
    return {f"{path.stem}: {name}": job for path in WORKFLOWS for name, job in parsed(path)["jobs"].items()}


def commands():
    return [step["run"] for job in jobs().values() for step in job["steps"] if "run" in step]


def test_workflows_read_only_unless_they_publish_and_every_job_ends():
    assert [path.stem for path in WORKFLOWS] == ["docs", "release", "tests"]
    for path in WORKFLOWS:
        assert parsed(path)["permissions"] == {"contents": "read"}
    rights = {name: job["permissions"] for name, job in jobs().items() if "permissions" in job}
    assert rights == {"release: publish": {"id-token": "write"}}
    assert all(job["timeout-minutes"] <= 40 for job in jobs().values())


def test_workflows_run_make_targets_and_on_other_systems_the_tests_of_make_core():
    targets = [command.removeprefix("make ") for command in commands() if command.startswith("make ")]
    assert sorted(targets) == ["docs", "release-check", "smoke", "test"]
    assert [target for target in targets if not re.search(rf"^{target}:", MAKEFILE, re.MULTILINE)] == []
    core = re.search(r"^CORE += (.+)$", MAKEFILE, re.MULTILINE)[1]
    assert f"python -m pytest {core}" in commands()
    packages = re.search(r"pip install .*--editable \. (.+)$", MAKEFILE, re.MULTILINE)[1]
    assert f"python -m pip install --editable . {packages}" in commands()


def test_every_version_of_python_that_is_promised_is_tested():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    promised = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    assert jobs()["tests: linux"]["strategy"]["matrix"]["python"] == promised
    assert project["requires-python"] == f">={promised[0]}"


def test_the_hook_and_make_lint_run_the_same_ruff():
    (hooks,) = [repo for repo in parsed(".pre-commit-config.yaml")["repos"] if "ruff" in repo["repo"]]
    pinned = re.search(r"^ruff==(.+)$", (ROOT / "constraints.txt").read_text("utf-8"), re.MULTILINE)[1]
    assert hooks["rev"] == f"v{pinned}"


def test_the_site_of_read_the_docs_is_that_of_make_docs():
    build = parsed(".readthedocs.yaml")
    (command,) = build["build"]["jobs"]["build"]["html"]
    options = "--builder html --conf-dir docs --fail-on-warning"
    assert command == f"python -m sphinx {options} . $READTHEDOCS_OUTPUT/html"
    assert f"sphinx-build {options} " in MAKEFILE
    assert build["python"]["install"] == [{"method": "pip", "path": ".", "extra_requirements": ["docs"]}]


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_forms_of_issues_ask_for_something(path):
    form = parsed(path)
    assert {"name", "description", "labels", "body"} == set(form)
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    assert len({field["id"] for field in fields}) == len(fields) >= 2
    named = re.findall(r"\b(?:docs/)?[\w-]+\.md\b", path.read_text("utf-8"))
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_the_citation_is_that_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    citation = parsed("CITATION.cff")
    name, subtitle = citation["title"].split(": ")
    assert name == project["name"].replace("-", "_")
    assert project["description"].lower().startswith(subtitle.lower())
    assert (citation["license"], citation["authors"]) == (project["license"], project["authors"])
    assert citation["keywords"] == project["keywords"]
    assert citation["references"][0]["url"] == project["urls"]["Paper"]
    assert citation["version"] == ptne_env.__version__


@pytest.fixture
def release(tmp_path, monkeypatch):
    """A repository whose commit may be tagged 1.2.3, with a function that runs git and one that commits a change."""
    monkeypatch.setattr(release_check, "stale_tables", lambda _: [])
    files = {
        "ptne_env/_version.py": '__version__ = "1.2.3"\n',
        "CHANGELOG.md": "# Changelog\n\nText.\n\n## 1.2.3 (2030-01-02)\n\n- More.\n\n## 1.2.2 (2029-01-02)\n",
        "CITATION.cff": "version: 1.2.3\ndate-released: 2030-01-02\n",
    }

    def git(*arguments):
        identity = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
        subprocess.run([shutil.which("git"), "-C", tmp_path, *identity, *arguments], check=True, capture_output=True)  # noqa: S603

    def commit(name, old="", new=""):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        text = path.read_text("utf-8") if path.exists() else files[name]
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")
        git("add", ".")
        git("commit", "--allow-empty", "-m", name)

    git("init")
    for name in files:
        commit(name)
    return tmp_path, git, commit


def test_a_release_that_is_ready_has_no_obstacle_with_and_without_its_tag(release):
    folder, git, _ = release
    assert list(release_check.obstacles(folder)) == []
    git("tag", "v1.2.3")
    assert list(release_check.obstacles(folder)) == []


@pytest.mark.parametrize(
    ("change", "obstacle"),
    [
        (("CHANGELOG.md", "1.2.3 (2030-01-02)", "1.2.3 (unreleased)"), "first heading must be '## 1.2.3"),
        (("CHANGELOG.md", "## 1.2.3", "## 1.2.4 (unreleased)\n\n## 1.2.3"), "first heading must be '## 1.2.3"),
        (("ptne_env/_version.py", "1.2.3", "1.2.4"), "first heading must be '## 1.2.4"),
        (("CITATION.cff", "1.2.3", "1.2.2"), "must be 1.2.3 and 2030-01-02, not 1.2.2 and 2030-01-02"),
        (("CITATION.cff", "date-released: 2030-01-02", ""), "not 1.2.3 and None"),
    ],
)
def test_files_that_disagree_are_obstacles(release, change, obstacle):
    folder, _, commit = release
    commit(*change)
    assert obstacle in " ".join(release_check.obstacles(folder))


def test_other_tags_and_changes_are_obstacles(release):
    folder, git, commit = release
    git("tag", "v1.2.2")
    (folder / "new.py").touch()
    found = " ".join(release_check.obstacles(folder))
    assert "tag v1.2.2 stands at this commit, whose version is 1.2.3" in found
    assert "changes that are not committed" in found
    git("tag", "v1.2.3")
    commit("CHANGELOG.md", "More", "Less")
    assert ["stands at another commit" in each for each in release_check.obstacles(folder)] == [True]


def test_documents_with_other_numbers_and_policies_without_any_are_obstacles(release, monkeypatch):
    monkeypatch.setattr(release_check, "stale_tables", lambda _: ["README.md"])
    monkeypatch.setattr(release_check.published, "missing", lambda _: ["static"])
    assert list(release_check.obstacles(release[0])) == [
        "static has no published numbers: run `make publish`.",
        "README.md: the tables are not those of the published numbers: run `python -m baselines.publish --tables`.",
    ]


def test_documents_with_another_digit_are_found(tmp_path):
    documents = [ROOT / "README.md", ROOT / "baselines" / "ptne-v1.md"]
    changed = [tmp_path / path.name for path in documents]
    for path, copy in zip(documents, changed, strict=True):
        row = re.search(r"^\| rounding \|.*$", path.read_text("utf-8"), re.MULTILINE)[0]
        wrong = re.sub(r"\d\b", lambda digit: str(9 - int(digit[0])), row)
        copy.write_text(path.read_text("utf-8").replace(row, wrong), encoding="utf-8")
    assert list(release_check.stale_tables(changed)) == ["README.md", "ptne-v1.md"]
