"""The speed benchmark runs; its figures are not tested."""

import importlib
from itertools import islice
from pathlib import Path


def test_our_environments_are_measured_with_peers_or_a_note(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1]))
    speed = importlib.import_module("benchmarks.speed")
    for _, contenders, notes in islice(speed.groups(is_quick=True), 2):
        rates = speed.interleave(contenders, 1, 0.01)
        assert {"ptne_env, scaled", "ptne_env, physical"} <= set(rates)
        assert len(rates) > 2 or "pip install" in notes[0]
        assert min(rate for found in rates.values() for rate in found) > 0
