"""Rules as a differentiable layer. Needs the extra `learn`.

`RuleLayer` computes the degrees from 0 to 1 to which rules derive atoms, from the degrees of the facts that they read:

- `godel`: "a and b" has the degree min(a, b), and "a or b" max(a, b);
- `product`: "a and b" has the degree a b, and "a or b" 1 - (1 - a)(1 - b);
- `lukasiewicz`: "a and b" has the degree max(0, a + b - 1), and "a or b" min(1, a + b).

In all of them, "not a" has the degree 1 - a.

The degree of a clause is that of the conjunction of its literals, and an atom has the degree of the disjunction over
all clauses that derive it and all values of their other variables. With the degrees 0 and 1, all three are the rules
themselves. With probabilities of independent facts, `product` counts a fact that several clauses or values share
several times. The degree of `godel` is above 0.5 exactly if the facts above 0.5 derive the atom.

Two further ones take degrees as the probabilities of independent facts:

- `exact` computes the probability of each decision by decision diagrams. They are compiled for each scene in which
  other facts are certain, that is, have the degree 0 or 1; certain facts get no gradient. The diagrams of scenes with
  many uncertain facts may grow too large.
- `top-k` keeps the `k` most probable proofs of each atom, and computes the probability that one of them holds (Huang et
  al.: Scallop, 2021). It is a lower bound for atoms that depend on no negation, else an approximation; with all proofs,
  it equals `exact`.
"""

from .exact import Proof
from .layer import DEFAULT, PRIORITY, RuleLayer, Semantics
from .weights import WeightedRules, learn_weights

__all__ = ["DEFAULT", "PRIORITY", "Proof", "RuleLayer", "Semantics", "WeightedRules", "learn_weights"]
