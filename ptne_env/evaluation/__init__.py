"""Who is better, by how much, and how sure? Seeded starts, rollouts, metrics, statistics, comparisons."""

from ptne_env.evaluation.bank import episode_seed as episode_seed
from ptne_env.evaluation.compare import Results as Results
from ptne_env.evaluation.compare import evaluate as evaluate
from ptne_env.evaluation.entries import COMPARED as COMPARED
from ptne_env.evaluation.entries import ENTRIES as ENTRIES
from ptne_env.evaluation.entries import Entry as Entry
from ptne_env.evaluation.entries import default_entries as default_entries
from ptne_env.evaluation.entries import get_entry as get_entry
from ptne_env.evaluation.entries import suite_entries as suite_entries
from ptne_env.evaluation.metrics import COMPARATIVE_METRICS as COMPARATIVE_METRICS
from ptne_env.evaluation.metrics import METRICS as METRICS
from ptne_env.evaluation.rollout import Rollout as Rollout
from ptne_env.evaluation.rollout import rollout as rollout
