"""Episodes of communicating teams: of two, all agents choose the same."""

from __future__ import annotations

from hypothesis import given, strategies as st

from mdm.team import Experience
from mdm.team.communicating.episode import Episode, Word, decode, encode

EPISODES = st.builds(Episode, st.integers(0, 3), st.integers(0, 3), st.sampled_from("abc"), st.booleans())


def test_later_commands_count_and_of_two_at_once_the_earlier_origin():
    first = Episode(1, 10, "a", True)
    assert first.supersedes(None)
    assert Episode(2, 12, "b", False).supersedes(first)
    assert Episode(1, 9, "a", True).supersedes(first)
    assert not Episode(1, 11, "b", True).supersedes(first)
    assert not first.supersedes(first)


@given(st.lists(EPISODES, min_size=1, unique_by=lambda each: (each.number, each.origin, each.by)), st.randoms())
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
    word = Word(Episode(1, 10, "a", True), "digest", (Experience(1, 0, None),))
    assert decode(encode(word)) == word
