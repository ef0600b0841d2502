"""The paper measured: continuous-time simulation, Table I, claims and errata."""
