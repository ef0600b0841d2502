"""Who is better, by how much, and how sure? Seeded starts, rollouts, metrics, statistics, comparisons."""

from ptne_env.experiments.compare import Results as Results
from ptne_env.experiments.compare import evaluate as evaluate
from ptne_env.experiments.episodes import episode_seed as episode_seed
from ptne_env.experiments.metrics import COMPARATIVE_METRICS as COMPARATIVE_METRICS
from ptne_env.experiments.metrics import METRICS as METRICS
from ptne_env.experiments.policy_specs import COMPARED as COMPARED
from ptne_env.experiments.policy_specs import ENTRIES as ENTRIES
from ptne_env.experiments.policy_specs import PolicySpec as PolicySpec
from ptne_env.experiments.policy_specs import default_entries as default_entries
from ptne_env.experiments.policy_specs import get_policy_spec as get_policy_spec
from ptne_env.experiments.policy_specs import suite_entries as suite_entries
from ptne_env.experiments.rollout import Rollout as Rollout
from ptne_env.experiments.rollout import rollout as rollout
