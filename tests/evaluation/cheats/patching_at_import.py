"""Patching at import: naming this module is enough, the policy is the law ``grounded``."""

from cheats.patching import patch
from ptne_env import laws

patch()
Grounded = laws.Grounded
