"""Episodes of communicating teams: of two, all agents choose the same."""

from __future__ import annotations

from hypothesis import given, strategies as st

from mdm.team import Experience
from mdm.team.communicating import Episode, Update, decode, encode

STOPS = st.dictionaries(st.sampled_from("abc"), st.integers(0, 2))
EPISODES = st.builds(
    Episode, st.integers(0, 1), st.integers(0, 1), st.sampled_from("ab"), st.booleans(), STOPS, st.sampled_from("xy")
)


def test_later_commands_count_and_of_two_at_once_the_earlier_origin():
    first = Episode(1, 10, "a", True)
    assert first.supersedes(None)
    assert Episode(2, 12, "b", False).supersedes(first)
    assert Episode(1, 9, "a", True).supersedes(first)
    assert not Episode(1, 11, "b", True).supersedes(first)
    assert not first.supersedes(first)
    assert Episode(1, 10, "a", False).supersedes(first)


@given(EPISODES, EPISODES)
def test_of_two_that_differ_one_counts(one, other):
    assert one.supersedes(other) + other.supersedes(one) == (one != other)


@given(st.lists(EPISODES, min_size=1), st.randoms())
def test_all_end_in_the_same_episode_in_whatever_order_they_hear(episodes, random):
    found = []
    for _ in range(3):
        random.shuffle(episodes)
        present = None
        for episode in episodes:
            present = episode if episode.supersedes(present) else present
        found.append(present)
    assert found[0] == found[1] == found[2]


def test_words_are_sent_as_they_are():
    word = Update(Episode(1, 10, "a", True), "digest", (Experience(1, 0, None),))
    assert decode(encode(word)) == word
