"""Comparisons of policies.

- ``comparison``: ``evaluate``, which makes jobs, one per policy and track; ``results``: what they give together
- ``policy_spec``: a policy of a comparison; ``named_policies``: the table of those with a name
- ``tracks``, ``episodes``: what they play, and from which seeds
- ``rollout``: plays and records; ``trajectories``: ``record``, which returns every instant
- ``audit``: whether a policy decides each row from that row alone
- ``metrics``, ``statistics``: numbers of an episode, and means with intervals
- ``provenance``: versions, hashes and the arithmetic of the machine
"""

from ptne_env.evaluation.comparison import evaluate as evaluate
from ptne_env.evaluation.episodes import EpisodeSet as EpisodeSet
from ptne_env.evaluation.episodes import episode_seed as episode_seed
from ptne_env.evaluation.metrics import METRICS as METRICS
from ptne_env.evaluation.metrics import OPTIONAL as OPTIONAL
from ptne_env.evaluation.metrics import Metric as Metric
from ptne_env.evaluation.metrics import register as register
from ptne_env.evaluation.named_policies import COMPARED as COMPARED
from ptne_env.evaluation.named_policies import ENTERED as ENTERED
from ptne_env.evaluation.policy_spec import POLICIES as POLICIES
from ptne_env.evaluation.policy_spec import PolicySpec as PolicySpec
from ptne_env.evaluation.policy_spec import get_policy_spec as get_policy_spec
from ptne_env.evaluation.results import Results as Results
from ptne_env.evaluation.rollout import Rollout as Rollout
from ptne_env.evaluation.rollout import rollout as rollout
from ptne_env.evaluation.tracks import Teammates as Teammates
from ptne_env.evaluation.tracks import Track as Track
from ptne_env.evaluation.trajectories import Trajectories as Trajectories
from ptne_env.evaluation.trajectories import record as record
