"""Example 1 of the paper: the energy consumption game on the 5-cycle.

The graph never changes.

| | |
| --- | --- |
| Import | `from ptne_env import energy_v0` |
| Registered as | `ptne/energy-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("energy")
