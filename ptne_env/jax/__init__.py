"""The world on JAX: pure functions that compile, batch, differentiate and run on any device; needs the extra ``jax``.

>>> world = ptne_env.jax.JaxWorld("random-energy-switching", interface="physical")
>>> policy = ptne_env.jax.static(world.layout, kappa=2.0)
>>> episodes = jax.jit(lambda key: ptne_env.jax.rollout(world, policy, key, 1024))(jax.random.key(0))
"""

try:
    import jax as _jax  # noqa: F401 - a clear message if it is missing
except ModuleNotFoundError as error:
    raise ImportError('ptne_env.jax needs JAX: pip install "ptne-env[jax]"') from error

from ptne_env.jax.environment import JaxWorld as JaxWorld
from ptne_env.jax.policies import JaxPolicy as JaxPolicy
from ptne_env.jax.policies import JaxRollout as JaxRollout
from ptne_env.jax.policies import adaptive as adaptive
from ptne_env.jax.policies import rollout as rollout
from ptne_env.jax.policies import static as static
