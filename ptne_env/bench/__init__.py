"""Benchmarks.

- ``suite``, ``ptne_v1``: what a suite is, and ours; ``leaderboard``: scores and ranks in it
- ``run``, ``workers``: many jobs on cores or machines; ``store``: what is done is not run again
- ``files``, ``verification``: results in files, and whether they can be believed
- ``report``: tables, pages and videos
"""

from ptne_env.bench.leaderboard import leaderboard as leaderboard
from ptne_env.bench.run import Runner as Runner
from ptne_env.bench.run import run_suite as run_suite
from ptne_env.bench.suite import Suite as Suite
from ptne_env.bench.suite import find_scenario as find_scenario
from ptne_env.bench.suite import get_suite as get_suite
from ptne_env.bench.workers import Workers as Workers
