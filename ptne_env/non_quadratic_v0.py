"""Example 2 of the paper, corrected: five players with non-quadratic costs on the 5-cycle.

The corrected variant has the equilibrium that the paper prints (docs/errata.md, 1).

| | |
| --- | --- |
| Import | `from ptne_env import non_quadratic_v0` |
| Registered as | `ptne/non-quadratic-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("non-quadratic")
