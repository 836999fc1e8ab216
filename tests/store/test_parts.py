"""What is missing of a range, whatever pieces of it are there."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from aoabench.store.parts import missing_ranges

pieces = st.lists(
    st.tuples(st.integers(0, 60), st.integers(1, 25)).map(lambda p: (p[0], p[0] + p[1])),
    max_size=8,
)


@given(pieces, st.integers(0, 60))
def test_gaps_and_pieces_make_the_whole_and_do_not_meet(done, reps):
    gaps = missing_ranges(done, reps)
    covered = {i for start, stop in done for i in range(start, stop)}
    missing = [i for start, stop in gaps for i in range(start, stop)]
    assert missing == sorted(set(range(reps)) - covered)
    assert all(start < stop for start, stop in gaps)
    assert all(before[1] < after[0] for before, after in pairwise(gaps))
