"""Comparisons of policies."""

from ptne_env.evaluation.comparison import evaluate as evaluate
from ptne_env.evaluation.episodes import EpisodeSet as EpisodeSet
from ptne_env.evaluation.episodes import episode_seed as episode_seed
from ptne_env.evaluation.metrics import METRICS as METRICS
from ptne_env.evaluation.metrics import OPTIONAL as OPTIONAL
from ptne_env.evaluation.metrics import Metric as Metric
from ptne_env.evaluation.metrics import register as register
from ptne_env.evaluation.named_policies import CODED as CODED
from ptne_env.evaluation.named_policies import COMPARED as COMPARED
from ptne_env.evaluation.named_policies import ENTERED as ENTERED
from ptne_env.evaluation.policy_spec import POLICIES as POLICIES
from ptne_env.evaluation.policy_spec import PolicySpec as PolicySpec
from ptne_env.evaluation.policy_spec import get_policy_spec as get_policy_spec
from ptne_env.evaluation.results import Results as Results
from ptne_env.evaluation.results import read_results as read_results
from ptne_env.evaluation.rollout import Rollout as Rollout
from ptne_env.evaluation.rollout import rollout as rollout
from ptne_env.evaluation.tracks import Teammates as Teammates
from ptne_env.evaluation.tracks import Track as Track
from ptne_env.evaluation.trajectories import Trajectories as Trajectories
from ptne_env.evaluation.trajectories import record as record
