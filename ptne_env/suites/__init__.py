"""Suites: published tracks, the rules by which policies are run on them, and leaderboards."""

from ptne_env.suites.suite import Suite as Suite
from ptne_env.suites.suite import find_scenario as find_scenario
from ptne_env.suites.suite import find_track as find_track
from ptne_env.suites.suite import get_suite as get_suite
from ptne_env.suites.suite import leaderboard as leaderboard
from ptne_env.suites.suite import run_suite as run_suite
