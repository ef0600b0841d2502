"""Example 1 over the same switching graphs, which dwell Δs = 0.25 of transformed time each.

Switching goes on for ever on the way to the deadline, as the proof of Theorem 4 needs.

| | |
| --- | --- |
| Import | `from ptne_env import energy_switching_transformed_v0` |
| Registered as | `ptne/energy-switching-transformed-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("energy-switching-transformed")
