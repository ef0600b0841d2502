"""The paper measured: continuous-time simulation, Table I, claims and errata."""

from baselines.paper.claims import Claim as Claim
from baselines.paper.experiments import Experiments as Experiments
from baselines.paper.table import TableRow as TableRow
from baselines.paper.table import table_one as table_one
