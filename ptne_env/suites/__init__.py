"""Suites: published tracks, the rules by which policies are run on them, and leaderboards."""

from ptne_env.evaluation.comparison import run_suite as run_suite
from ptne_env.evaluation.tracks import Suite as Suite
from ptne_env.evaluation.tracks import get_suite as get_suite
from ptne_env.suites.leaderboard import leaderboard as leaderboard
