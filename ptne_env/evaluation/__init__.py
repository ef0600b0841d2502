"""Experiments: episode sets, rollouts, metrics, statistics, suites and comparisons."""

from ptne_env.evaluation.episodes import EpisodeSet as EpisodeSet
from ptne_env.evaluation.episodes import episode_seed as episode_seed
from ptne_env.evaluation.metrics import METRICS as METRICS
from ptne_env.evaluation.metrics import Metric as Metric
from ptne_env.evaluation.metrics import register as register
from ptne_env.evaluation.policy_specs import COMPARED as COMPARED
from ptne_env.evaluation.policy_specs import POLICIES as POLICIES
from ptne_env.evaluation.policy_specs import PolicySpec as PolicySpec
from ptne_env.evaluation.policy_specs import default_policies as default_policies
from ptne_env.evaluation.policy_specs import get_policy_spec as get_policy_spec
from ptne_env.evaluation.policy_specs import suite_policies as suite_policies
from ptne_env.evaluation.results import Results as Results
from ptne_env.evaluation.rollout import Rollout as Rollout
from ptne_env.evaluation.rollout import rollout as rollout
from ptne_env.evaluation.run import evaluate as evaluate
from ptne_env.evaluation.run import run_suite as run_suite
from ptne_env.evaluation.suite import Suite as Suite
from ptne_env.evaluation.suite import Teammates as Teammates
from ptne_env.evaluation.suite import Track as Track
from ptne_env.evaluation.suite import get_suite as get_suite
from ptne_env.evaluation.workers import Workers as Workers
