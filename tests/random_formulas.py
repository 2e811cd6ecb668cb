"""Random formulas over predicates, for property tests."""

from __future__ import annotations

from hypothesis import strategies as st

from mdm.logic import P
from mdm.logic.formula import Constant

VALUES = (True, False, None)
names = st.sampled_from(
    ["a", "b", "IsMoving", "robot2/IsMoving", "Patrol.succeeded", "and", "person is waiting", 'say "x"']
)
formulas = st.recursive(
    st.builds(P, names) | st.builds(Constant, st.booleans()),
    lambda inner: st.one_of(
        inner.map(lambda f: ~f),
        st.tuples(inner, inner).map(lambda pair: pair[0] & pair[1]),
        st.tuples(inner, inner).map(lambda pair: pair[0] | pair[1]),
        st.tuples(inner, inner).map(lambda pair: pair[0] ^ pair[1]),
        st.tuples(inner, inner).map(lambda pair: pair[0] >> pair[1]),
    ),
    max_leaves=12,
)
