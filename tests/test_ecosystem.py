"""The examples for frameworks that the test extra installs, and the runner of all examples for other frameworks."""

import importlib.metadata
import importlib.util
import json
import re
import sys
import time
from pathlib import Path
from urllib.error import URLError

import numpy as np
import pytest
from extras import need_sb3, need_torchrl
from processes import run_python

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "ecosystem"
HERE = [
    path
    for path in sorted(FOLDER.glob("*_*.py"))
    if path.stem.split("_")[0] in ("pettingzoo", "gymnasium", "sb3", "cleanrl")
]


def load(name):
    spec = importlib.util.spec_from_file_location(f"ecosystem_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def need_original_of_cleanrl(monkeypatch):
    """Skip what asks, unless CleanRL's script has its package and is stored, or can be downloaded."""
    pytest.importorskip("tyro", reason="needs tyro: pip install -r examples/ecosystem/requirements/cleanrl.txt")
    monkeypatch.syspath_prepend(str(FOLDER))
    try:
        load("cleanrl_original").script()
    except SystemExit as missing:
        if "needs the network" not in str(missing):
            raise
        pytest.skip(str(missing))


@pytest.mark.parametrize("example", HERE, ids=lambda path: path.stem)
def test_example_agrees_with_evaluate_and_training_gains_digits(example, tmp_path, monkeypatch):
    if example.stem == "cleanrl_original":
        need_original_of_cleanrl(monkeypatch)
    row = json.loads(run_python(example, folder=tmp_path).stdout.splitlines()[-1])
    assert row["difference"] < 1e-4
    assert (row["before"] is None) == (example.stem.split("_")[0] in ("pettingzoo", "gymnasium"))
    assert list(tmp_path.iterdir()) == []


def test_a_script_that_cannot_be_downloaded_is_named_with_its_place(tmp_path, monkeypatch):
    need_sb3()
    monkeypatch.syspath_prepend(str(FOLDER))
    example = load("cleanrl_original")

    def fail(address, timeout):
        raise URLError("Name or service not known")

    monkeypatch.setattr(example, "urlopen", fail)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    place = re.escape(str(tmp_path / example.SCRIPT))
    with pytest.raises(SystemExit, match=f"cannot download {example.ADDRESS} .*needs the network, or .* {place}"):
        example.script()
    assert list(tmp_path.iterdir()) == []


# --- the yardstick ----------------------------------------------------------------------------------------------------


def test_a_wrapper_that_changes_the_digits_is_an_error(capsys):
    yardstick = load("yardstick")
    with pytest.raises(SystemExit, match="through the wrapper the law gained"):
        yardstick.report([1.0, 2.0])
    gained = _gained(yardstick, 2)
    with pytest.raises(SystemExit, match="through the wrapper"):
        yardstick.report(gained[::-1])  # the seeds did not reach the environment
    yardstick.report(gained)
    row = json.loads(capsys.readouterr().out)
    nothing = dict.fromkeys(("before", "after", "speed"))
    assert row == {"what": "", "law": gained.mean(), "difference": 0.0, **nothing}


def test_a_training_without_gain_is_an_error():
    yardstick = load("yardstick")
    with pytest.raises(SystemExit, match="training gained no digits: 4.0 before, 4.0 after"):
        yardstick.report(_gained(yardstick, 1), before=4.0, after=4.0)


def test_a_trained_function_gets_whole_blocks_of_rows():
    seen = []
    policy = load("yardstick").Acting(lambda rows: seen.append(rows) or 2 * rows)
    actions, _ = policy.predict(np.ones((40, 3), dtype=np.float32))
    assert [rows.shape for rows in seen] == [(64, 3)]
    assert np.array_equal(actions, np.full((40, 3), 2))


def test_speeds_are_agent_steps_per_second_of_every_route():
    def route(pause):
        return lambda: time.sleep(pause) or 10

    slow, fast = load("yardstick").speeds(route(0.01), route(0.001), seconds=0.02, turns=1)
    assert 0 < slow < 10 / 0.01
    assert 0 < fast < 10 / 0.001


def test_the_law_gains_its_digits_in_the_batch_of_torchrl(monkeypatch):
    need_torchrl()
    monkeypatch.syspath_prepend(str(FOLDER))
    from ptne_env.envs.torchrl import TorchRLEnv

    yardstick = load("yardstick")
    gained = load("tensordicts").law_digits(TorchRLEnv(yardstick.SCENARIO, yardstick.EPISODES))
    assert gained == pytest.approx(_gained(yardstick, len(gained)), abs=1e-6)


def _gained(yardstick, episodes):
    scenario = yardstick.ptne_env.get_scenario(yardstick.SCENARIO)
    law = yardstick.PolicySpec("law", yardstick.law)
    results = yardstick.ptne_env.evaluate([law], [scenario], episodes=episodes, split="train", against_laws=False)
    return results.samples[yardstick.SCENARIO, "law"]["digits_gained"][0]


# --- the runner -------------------------------------------------------------------------------------------------------

GOOD = """
import json
print("some talk")
row = {"what": "a network", "law": 3.5, "difference": 2e-16, "before": 1.0, "after": 2.25, "speed": 123456.0}
print(json.dumps(row))
"""
BAD = """
import sys
for line in range(30):
    print("line", line)
sys.exit("the last word")
"""


@pytest.fixture
def runner(tmp_path, monkeypatch):
    """The runner on a folder with the frameworks "alpha" and "beta", without their installation."""
    module = load("run")
    (tmp_path / "requirements").mkdir()
    for framework in ("alpha", "beta"):
        (tmp_path / "requirements" / f"{framework}.txt").write_text("numpy>=1\npytest[extra]==9\n", encoding="utf-8")
        (tmp_path / f"{framework}_example.py").write_text(GOOD, encoding="utf-8")
    page = tmp_path / "page.md"
    page.write_text(f"head\n\n{module.BEGIN}\nold\n{module.END}\n\ntail\n", encoding="utf-8")
    monkeypatch.setattr(module, "FOLDER", tmp_path)
    monkeypatch.setattr(module, "PAGE", page)
    monkeypatch.setattr(module, "prepare", lambda framework, home: Path(sys.executable))
    monkeypatch.setattr(module, "versions", lambda framework, python: {framework: "1.2"})
    return module


def test_a_complete_run_writes_the_table_between_the_marks(runner):
    assert runner.main([]) == 0
    text = runner.PAGE.read_text(encoding="utf-8")
    assert text.startswith("head\n")
    assert text.endswith("tail\n")
    assert "old" not in text
    for framework in ("alpha", "beta"):
        assert f"| `{framework}` | {framework} 1.2 |" in text
        row = (
            rf"\| \[{framework}_example\]\(.*\), a network \| 3\.500000 \| 2e-16 \| 1\.00 \| 2\.25 \| 120,000 \| \d+ \|"
        )
        assert len(re.findall(row, text)) == 1
    assert runner.main([]) == 0
    assert runner.PAGE.read_text(encoding="utf-8").count(runner.BEGIN) == 1


def test_a_run_of_some_frameworks_replaces_their_rows_alone(runner, capsys):
    assert runner.main([]) == 0
    alpha = [line for line in runner.PAGE.read_text(encoding="utf-8").splitlines() if "alpha" in line]
    assert len(alpha) == 2
    (runner.FOLDER / "alpha_example.py").write_text(BAD, encoding="utf-8")
    (runner.FOLDER / "beta_example.py").write_text(GOOD.replace("2.25", "3.75"), encoding="utf-8")
    capsys.readouterr()
    assert runner.main(["--only", "beta"]) == 0
    assert "alpha" not in capsys.readouterr().out
    lines = runner.PAGE.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if "alpha" in line] == alpha
    (result,) = [line for line in lines if "beta_example" in line]
    assert "| 1.00 | 3.75 |" in result
    assert [line[:9] for line in lines if line.startswith(("| `", "| ["))] == [
        "| `alpha`",
        "| `beta` ",
        "| [alpha_",
        "| [beta_e",
    ]


def test_rows_of_a_framework_that_no_longer_exists_are_removed(runner):
    assert runner.main([]) == 0
    (runner.FOLDER / "requirements" / "alpha.txt").unlink()
    assert runner.main(["--only", "beta"]) == 0
    assert "alpha" not in runner.PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("program", "complaint"),
    [(BAD, "line 29\nthe last word\nexit code 1"), ("print('hm')", "it reported nothing; it printed:\nhm")],
)
def test_a_failure_prints_its_last_lines_and_the_others_go_on(runner, capsys, program, complaint):
    (runner.FOLDER / "alpha_example.py").write_text(program, encoding="utf-8")
    before = runner.PAGE.read_text(encoding="utf-8")
    assert runner.main([]) == 1
    printed = capsys.readouterr()
    assert f"alpha: alpha_example failed\n{'' if 'hm' in program else 'line 11'}" in printed.err
    assert complaint in printed.err
    assert "line 10\n" not in printed.err
    assert "failed: alpha; the page stays as it is" in printed.err
    assert '"example": "beta_example"' in printed.out
    assert runner.PAGE.read_text(encoding="utf-8") == before


def test_an_unknown_framework_is_an_error_of_usage(runner):
    with pytest.raises(SystemExit) as error:
        runner.main(["--only", "gamma"])
    assert error.value.code == 2


def test_an_example_that_hangs_is_stopped(runner):
    with pytest.raises(runner.FailedError, match="timed out after 0.2 seconds"):
        runner.call([sys.executable, "-c", "import time; time.sleep(60)"], timeout=0.2)


def test_an_environment_is_made_anew_when_its_requirements_change(tmp_path, monkeypatch):
    module = load("run")
    calls = []

    def call(command):
        calls.append([str(part) for part in command])
        (tmp_path / "cleanrl").mkdir(exist_ok=True)

    monkeypatch.setattr(module, "call", call)
    python = module.prepare("cleanrl", tmp_path)
    assert python == tmp_path / "cleanrl" / "bin" / "python"
    assert [command[1:3] for command in calls] == [["-m", "venv"], ["-m", "pip"]]
    assert str(FOLDER / "requirements" / "cleanrl.txt") in calls[1]
    module.prepare("cleanrl", tmp_path)
    assert len(calls) == 2
    other = tmp_path / "other.txt"
    other.write_text("torch==0\n", encoding="utf-8")
    monkeypatch.setattr(module, "requirements", lambda framework: other)
    module.prepare("cleanrl", tmp_path)
    assert len(calls) == 4


def test_an_installation_that_failed_is_tried_again(tmp_path, monkeypatch):
    module = load("run")
    monkeypatch.setattr(module.sys, "executable", str(tmp_path / "no-such-python"))
    for _ in range(2):
        with pytest.raises(module.FailedError, match="no-such-python"):
            module.prepare("cleanrl", tmp_path)
    assert not (tmp_path / "cleanrl").exists()


def test_versions_are_those_of_the_installed_packages():
    module = load("run")
    found = module.versions("sb3", Path(sys.executable))
    batched = [name for name in ("tensordict", "torchrl") if importlib.util.find_spec(name)]
    named = ["stable-baselines3", "sb3-contrib", "torch", "gymnasium", "pettingzoo"]
    assert list(found) == [*named, *batched, "numpy"]
    for name, version in found.items():
        assert version == importlib.metadata.version(name).partition("+")[0]


# --- the page ---------------------------------------------------------------------------------------------------------


def test_every_example_has_its_row_and_versions_on_the_page():
    module = load("run")
    text = module.PAGE.read_text(encoding="utf-8")
    frameworks = module.frameworks()
    examples = [path.stem for path in sorted(FOLDER.glob("*_*.py"))]
    assert {name.split("_")[0] for name in examples} == set(frameworks)
    assert [name for name in examples if f"| [{name}](" not in text] == []
    for framework in frameworks:
        (printed,) = re.findall(rf"\| `{framework}` \| (.*) \|", text)
        pins = re.findall(r"^([\w-]+)(?:\[.*\])?==([\d.]+)", module.requirements(framework).read_text(), re.MULTILINE)
        assert pins
        assert [f"{name} {version}" for name, version in pins if f"{name} {version}" not in printed] == []
