"""Reproduction of the paper: continuous-time simulation, Table I, all figures, measured claims and errata."""

from ptne_env.theory.paper.claims import Claim as Claim
from ptne_env.theory.paper.experiments import Experiments as Experiments
from ptne_env.theory.paper.reproduction import Reproduction as Reproduction
from ptne_env.theory.paper.reproduction import reproduce as reproduce
from ptne_env.theory.paper.table import TableRow as TableRow
from ptne_env.theory.paper.table import table_one as table_one
