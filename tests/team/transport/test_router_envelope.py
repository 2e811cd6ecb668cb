from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, strategies as st
from sentences import refused

from mdm.errors import Error
from mdm.team.transport.keys import join
from mdm.team.transport.router import Packer, Refusal, Unpacker, check_size

KEY = join("rescue", "robot1", "patrol", "state")
NAMES = st.text(st.characters(exclude_characters="/*$#?@", exclude_categories=["C", "Z"]), min_size=1, max_size=64)


def reader(missing=None, *more, **options):
    missing = missing or (lambda key, count: pytest.fail("nothing is missing"))
    return Unpacker("rescue", "receiver", missing, *more, **options)


def packer(owner="robot1", incarnation=1, **options):
    return Packer(owner, incarnation, lambda: 42, **options)


def kind_of(unpacker, key, data, now=0):
    with pytest.raises(Refusal) as refused:
        unpacker.unpack(key, data, now)
    assert str(refused.value)
    return refused.value.kind


@given(NAMES, st.integers(0, 2**63 - 1), st.lists(st.binary(max_size=100), max_size=5))
def test_what_is_packed_is_unpacked(owner, incarnation, bodies):
    sender, receiver = packer(owner, incarnation), reader()
    key = join("rescue", owner, "patrol", "state")
    for body in bodies:
        sample = receiver.unpack(key, sender.pack(key, body))
        assert (sample.key, sample.owner, sample.incarnation, sample.body) == (key, owner, incarnation, body)
        assert sample.time == 42


@given(st.binary(max_size=60))
def test_garbage_is_refused(data):
    assert kind_of(reader(), KEY, data) == "malformed"


@given(st.data())
def test_damaged_messages_are_refused_or_whole(data):
    whole = packer().pack(KEY, b"body")
    place = data.draw(st.integers(0, len(whole) - 1))
    damaged = whole[:place] + bytes([data.draw(st.integers(0, 255))]) + whole[place + 1 :]
    cut = damaged[: data.draw(st.integers(0, len(whole)))]
    try:
        sample = reader().unpack(KEY, cut)
    except Refusal as refusal:
        assert refusal.kind in {"malformed", "version", "foreign"}
    else:
        assert sample.owner == "robot1"


def test_a_newer_version_is_refused():
    assert kind_of(reader(), KEY, packer(version=2).pack(KEY, b"")) == "version"


def test_a_message_under_the_key_of_another_is_refused():
    assert kind_of(reader(), KEY, packer("robot2").pack(KEY, b"")) == "foreign"
    assert kind_of(reader(), "mdm/other/robot2/a/b", packer("robot2").pack(KEY, b"")) == "foreign"


def test_what_another_process_sends_under_ones_own_key_is_refused():
    key = join("rescue", "receiver", "patrol", "state")
    assert kind_of(reader(), key, packer("receiver").pack(key, b"")) == "foreign"


def test_a_message_cut_short_behind_one_that_was_whole_is_refused():
    sender, receiver = packer(), reader()
    receiver.unpack(KEY, sender.pack(KEY, b""))
    data = sender.pack(KEY, b"")
    for end in range(len(data)):
        assert kind_of(receiver, KEY, data[:end]) == "malformed"
    receiver.largest = len(data)
    assert kind_of(receiver, KEY, sender.pack(KEY, b"x")) == "oversize"
    receiver.unpack(KEY, data)


def test_what_is_too_large_is_refused_at_both_ends():
    data = packer().pack(KEY, b"x" * 100)
    assert kind_of(reader(largest=100), KEY, data) == "oversize"
    with refused(Error):
        check_size(KEY, data, 100)


def test_what_comes_again_or_late_is_refused():
    sender, receiver = packer(), reader(lambda key, count: None)
    first, second = sender.pack(KEY, b"1"), sender.pack(KEY, b"2")
    receiver.unpack(KEY, second)
    assert kind_of(receiver, KEY, second) == "repeated"
    assert kind_of(receiver, KEY, first) == "repeated"


@pytest.mark.parametrize("ahead", [2000, 2**64 - 1])
def test_a_forged_number_far_ahead_silences_nobody_for_long(ahead):
    told = []
    sender, forger = packer(), packer()
    receiver = reader(lambda key, count: None, told.append)
    receiver.unpack(KEY, sender.pack(KEY, b""))
    forger.sent[KEY] = [ahead - 1, 0]
    receiver.unpack(KEY, forger.pack(KEY, b"forged"))
    dropped = [kind_of(receiver, KEY, sender.pack(KEY, b"")) for _ in range(7)]
    assert dropped == ["repeated"] * 7
    assert told == []
    for _ in range(100):
        assert receiver.unpack(KEY, sender.pack(KEY, b"honest")).body == b"honest"
    assert told == [KEY]


@pytest.mark.parametrize("ahead", [5, 2000, 2**64 - 2])
def test_a_forged_number_silences_nobody_who_speaks_once_a_second(ahead):
    """What the agents of a stopped team say, a stop among it, they say once a lease."""
    now = 10**18
    sender, forger = (Packer("robot1", 1, lambda: now) for _ in range(2))
    receiver = reader(lambda key, count: None)
    receiver.unpack(KEY, sender.pack(KEY, b""), now)
    forger.sent[KEY] = [ahead, 0]
    receiver.unpack(KEY, forger.pack(KEY, b"forged"), now)
    now += 10**9
    assert kind_of(receiver, KEY, sender.pack(KEY, b""), now) == "repeated"
    for _ in range(3):
        now += 10**9
        assert receiver.unpack(KEY, sender.pack(KEY, b"honest"), now).body == b"honest"


def test_the_last_messages_of_a_key_that_come_again_at_their_pace_are_refused():
    now = 10**18
    sender = Packer("robot1", 1, lambda: now)
    receiver = reader(lambda key, count: None, lambda key: pytest.fail("these are repeated"))
    messages = []
    for _ in range(2):
        messages.append(sender.pack(KEY, b""))
        receiver.unpack(KEY, messages[-1], now)
        now += 10**9
    for message in messages:
        assert kind_of(receiver, KEY, message, now) == "repeated"
        now += 10**9


def test_messages_that_come_again_one_after_the_other_are_refused_all_the_same():
    sender, receiver = packer(), reader(lambda key, count: None, lambda key: pytest.fail("these are repeated"))
    messages = [sender.pack(KEY, b"") for _ in range(1000)]
    for message in messages:
        receiver.unpack(KEY, message)
    for message in messages:
        assert kind_of(receiver, KEY, message) == "repeated"
    early = sender.pack(KEY, b"")
    receiver.unpack(KEY, [sender.pack(KEY, b"") for _ in range(3000)][-1])
    for _ in range(20):
        assert kind_of(receiver, KEY, early) == "repeated"


def test_a_forged_life_silences_nobody_who_is_seen_to_live():
    receiver = reader(lambda key, count: None)
    receiver.present("robot1", 3)
    sender, forger = packer(incarnation=3), packer(incarnation=2**63 - 1)
    receiver.unpack(KEY, sender.pack(KEY, b""))
    receiver.unpack(KEY, forger.pack(KEY, b""))
    for _ in range(3):
        assert receiver.unpack(KEY, sender.pack(KEY, b"honest")).body == b"honest"


def test_gaps_are_told_and_those_that_are_excused_are_not():
    told = []
    sender, receiver = packer(), reader(lambda key, count: told.append((key, count)))
    messages = [sender.pack(KEY, b"") for _ in range(10)]
    receiver.unpack(KEY, messages[2])  # the first that a late joiner sees is no gap
    receiver.unpack(KEY, messages[3])
    receiver.unpack(KEY, messages[6])
    receiver.excuse(KEY, 1)
    receiver.unpack(KEY, messages[9])
    assert told == [(KEY, 2), (KEY, 1)]


def test_a_leap_counts_when_a_second_message_confirms_it_and_a_forged_one_never():
    told = []
    now = 10**12
    sender, other = (Packer("robot1", 1, lambda: now) for _ in range(2))
    receiver = reader(lambda key, count: told.append(count))
    receiver.unpack(KEY, sender.pack(KEY, b""), now)
    other.sent[KEY] = [2**64 - 2, 0]
    receiver.unpack(KEY, other.pack(KEY, b"forged"), now)
    for _ in range(20):
        with contextlib.suppress(Refusal):
            receiver.unpack(KEY, sender.pack(KEY, b""), now)
    assert sum(told) < 10
    told.clear()
    sender.sent[KEY][0] += 5000
    receiver.unpack(KEY, sender.pack(KEY, b""), now)
    assert told == []
    receiver.unpack(KEY, sender.pack(KEY, b""), now)
    receiver.unpack(KEY, sender.pack(KEY, b""), now)
    assert told == [5000]


def test_numbers_begin_anew_in_a_new_life_and_the_old_one_is_stale():
    old, new, receiver = packer(), packer(incarnation=2), reader()
    late = old.pack(KEY, b"")
    receiver.unpack(KEY, old.pack(KEY, b"old"))
    assert receiver.unpack(KEY, new.pack(KEY, b"new")).body == b"new"
    assert kind_of(receiver, KEY, late) == "stale"


def test_the_life_that_is_seen_counts_even_where_clocks_were_set_back():
    receiver = reader()
    receiver.unpack(KEY, packer(incarnation=7).pack(KEY, b""))
    receiver.present("robot1", 3)
    back = packer(incarnation=3)
    assert receiver.unpack(KEY, back.pack(KEY, b"back")).body == b"back"
    assert receiver.unpack(KEY, back.pack(KEY, b"again")).body == b"again"


def test_the_life_that_was_gone_is_stale_even_where_its_messages_follow_each_other():
    old, receiver = packer(), reader()
    receiver.unpack(KEY, old.pack(KEY, b""))
    receiver.present("robot1", 2)
    assert kind_of(receiver, KEY, old.pack(KEY, b"")) == "stale"
    receiver.present("robot1", 1)
    assert receiver.unpack(KEY, old.pack(KEY, b"live after all")).body == b"live after all"


def test_memory_is_bounded_under_ever_new_keys():
    sender, receiver = packer(), reader()
    for number in range(5000):
        key = join("rescue", "robot1", "patrol", f"c{number}")
        receiver.unpack(key, sender.pack(key, b""))
    assert len(receiver._last) == 4096


def test_answers_are_of_the_owner_of_their_key():
    receiver = reader()
    assert receiver.unseal(KEY, packer().seal(b"yes"), of_owner=True).body == b"yes"
    assert receiver.unseal(KEY, packer("robot2").seal(b"how are you"), of_owner=False).owner == "robot2"
    with refused(Refusal):
        receiver.unseal(KEY, packer("robot2").seal(b"yes"), of_owner=True)


@pytest.mark.parametrize("life", [2**63, 2**64 - 1])
def test_a_life_that_no_agent_has_is_refused(life):
    unpacker = Unpacker("team", "a", lambda *_: None)
    key = "mdm/team/b/e/c"
    with refused(Refusal):
        unpacker.unpack(key, Packer("b", life, int).pack(key, b""))
    assert unpacker.unpack(key, Packer("b", 1, int).pack(key, b"good")).body == b"good"
