"""The matrix O of the proof of Theorem 1."""

import numpy as np


def proof_matrix(constants, algebraic_connectivity, players, kappa):
    """O/2 = [[ε/N, −ι/√N], [−ι/√N, κ λ2 − ι]] with the matrix O of eq. (24), shape (2, 2).

    With a the norm of the mean part 1⊗ē of an error e, and b that of the rest, eᵀ M e ≥ (a, b) O/2 (a, b)ᵀ. So
    ‖**x** − 1⊗x*‖ falls at least like e^{−λ_min(O/2) τ} from every start. λ_min(O/2) is positive exactly when the gain
    condition holds.
    """
    coupling = constants.iota / np.sqrt(players)
    corner = kappa * algebraic_connectivity - constants.iota
    return np.array([[constants.epsilon / players, -coupling], [-coupling, corner]])
