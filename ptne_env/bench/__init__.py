"""Benchmarks: suites, their leaderboards, runs on many processes or machines, and checks of published results."""

from ptne_env.bench.leaderboard import leaderboard as leaderboard
from ptne_env.bench.run import Runner as Runner
from ptne_env.bench.run import run_suite as run_suite
from ptne_env.bench.suite import Suite as Suite
from ptne_env.bench.suite import find_scenario as find_scenario
from ptne_env.bench.suite import get_suite as get_suite
from ptne_env.bench.workers import Workers as Workers
