"""A new affine game of known monotonicity and a new start in every episode, on the 5-cycle.

The family is `ptne_env.games.RandomAffine`.

| | |
| --- | --- |
| Import | `from ptne_env import random_affine_v0` |
| Registered as | `ptne/random-affine-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("random-affine")
