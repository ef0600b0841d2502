"""Running jobs on cores or machines, and storing their results."""

from ptne_env.execution.runner import Runner as Runner
from ptne_env.execution.workers import Workers as Workers
