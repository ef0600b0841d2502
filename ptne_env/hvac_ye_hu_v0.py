"""Ye and Hu's energy consumption game on the 5-cycle.

The paper's game, `ptne_env.games.EnergyGame`, with the numbers of Ye and Hu (2017), from a random start.

| | |
| --- | --- |
| Import | `from ptne_env import hvac_ye_hu_v0` |
| Registered as | `ptne/hvac-ye-hu-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("hvac-ye-hu")
