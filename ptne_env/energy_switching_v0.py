"""Example 1 over the paper's switching graphs, which dwell 0.1 s of physical time each.

Only twelve switches happen before the deadline, after which the last, disconnected graph is frozen
(docs/errata.md, 2).

| | |
| --- | --- |
| Import | `from ptne_env import energy_switching_v0` |
| Registered as | `ptne/energy-switching-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("energy-switching")
