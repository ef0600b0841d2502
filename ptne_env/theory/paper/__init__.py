"""The paper measured: continuous-time simulation, Table I, claims and errata."""

from ptne_env.theory.paper.claims import Claim as Claim
from ptne_env.theory.paper.experiments import Experiments as Experiments
from ptne_env.theory.paper.table import TableRow as TableRow
from ptne_env.theory.paper.table import table_one as table_one
