"""The paper measured: continuous-time simulation, Table I, claims and errata."""

from paper.claims import Claim as Claim
from paper.experiments import Experiments as Experiments
from paper.table import TableRow as TableRow
from paper.table import table_one as table_one
