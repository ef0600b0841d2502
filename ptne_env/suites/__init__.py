"""Suites: published tracks with their rules.

- ``suite``: what a suite is, and how policies are run on it; ``ptne_v1``, ``robustness``: ours
- ``leaderboard``: scores and ranks
"""

from ptne_env.suites.suite import Suite as Suite
from ptne_env.suites.suite import find_scenario as find_scenario
from ptne_env.suites.suite import get_suite as get_suite
from ptne_env.suites.suite import leaderboard as leaderboard
from ptne_env.suites.suite import run_suite as run_suite
