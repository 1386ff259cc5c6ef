from __future__ import annotations

import json
import math

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motionkit.play.limits import Limits, RateLimit
from motionkit.play.requests import MAX_SPEED, REQUESTS, ROUND_OFF, ProtocolError, Request, parse_request


def test_defaults_of_a_wish() -> None:
    assert parse_request('{"do": "wish"}') == Request(
        "wish", {"character": None, "velocity": (0.0, 0.0), "facing": None, "type": None, "seq": 0}
    )


def test_every_field_is_read() -> None:
    asked = parse_request(
        '{"do": "path", "character": 2, "points": [[0, 1.5], [3, 4]], "type": "walking", "speed": 120,'
        ' "stops": [[1, 2]], "seq": 4294967295}'
    )
    assert asked.fields == {
        "character": 2,
        "points": [(0.0, 1.5), (3.0, 4.0)],
        "type": "walking",
        "speed": 120.0,
        "stops": [(1, 2.0)],
        "seq": 2**32 - 1,
    }
    assert parse_request('{"do": "wish", "velocity": null}').fields["velocity"] is None
    assert parse_request('{"do": "wish", "velocity": [-600, 800]}').fields["velocity"] == (-600.0, 800.0)


def test_the_highest_speed_holds_in_every_direction() -> None:
    for degrees in range(360):
        turn = math.radians(degrees)
        velocity = [MAX_SPEED * math.sin(turn), MAX_SPEED * math.cos(turn)]
        parse_request(json.dumps({"do": "wish", "velocity": velocity}))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected a JSON object"),
        ("hello", "expected a JSON object"),
        ("[1, 2]", "expected a JSON object, found '[1, 2]'"),
        ("null", "expected a JSON object"),
        ("[" * 60000, "expected a JSON object"),
        ('{"do": "wish"', "expected a JSON object"),
        ('{"do": "wish", "facing": NaN}', "NaN is not a finite number"),
        ('{"do": "wish", "facing": -Infinity}', "-Infinity is not a finite number"),
        ('{"do": "wish", "facing": 1e999}', "1e999 is not a finite number"),
        ('{"do": "wish", "facing": ' + "9" * 400 + "}", "an integer of 400 digits"),
        ('{"do": "wish", "facing": ' + "9" * 30 + "}", "facing: expected a number"),
        ('{"do": "wish", "facing": true}', "facing: expected a number from -1000 to 1000, found True"),
        ('{"do": "wish", "velocity": [1]}', "velocity: expected two numbers [x, z], found [1]"),
        ('{"do": "wish", "velocity": [0, 1000.1]}', "velocity: expected a number from -1000 to 1000"),
        ('{"do": "wish", "velocity": [800, 700]}', "velocity: expected a velocity of at most 1000 cm/s"),
        ('{"do": "wish", "velocity": "fast"}', "velocity: expected two numbers"),
        ('{"do": "wish", "type": 7}', "type: expected a name"),
        ('{"do": "wish", "type": "' + "a" * 101 + '"}', "type: expected a name of at most 100 characters"),
        ('{"do": "wish", "seq": -1}', "seq: expected a whole number from 0 to 4294967295, found -1"),
        ('{"do": "wish", "seq": 1.5}', "seq: expected a whole number"),
        ('{"do": "wish", "speed": 3}', "wish: unknown field 'speed', expected character, velocity"),
        ('{"do": "fly"}', 'expected "do" to be one of wish, perform'),
        ('{"do": ["wish"]}', 'expected "do" to be one of'),
        ('{"velocity": [0, 1]}', 'expected "do" to be one of'),
        ('{"do": "perform"}', "perform: type is missing"),
        ('{"do": "record", "on": 1}', "on: expected true or false, found 1"),
        ('{"do": "noise", "kind": "pink"}', "kind: expected one of mean, sample, correlated, found 'pink'"),
        ('{"do": "path", "points": [[0, 0]]}', "points: expected 2 to 2000 points"),
        ('{"do": "path", "points": [[0, 0], [0]]}', "points: expected two numbers"),
        ('{"do": "path", "points": [[0, 0], [0, 9]], "stops": [1]}', "stops: expected at most 100 stops"),
        (
            '{"do": "path", "points": [[0, 0], [0, 9]], "stops": [[1, 0]]}',
            "stops: expected a number from 0.1",
        ),
        (
            '{"do": "path", "points": [[0, 0], [0, 9]], "stops": [[0, 1]]}',
            "stops: expected numbers of points",
        ),
        ('{"do": "path", "points": [[0, 0], [0, 9]], "stops": [[2, 1], [2, 1]]}', "stops: expected numbers"),
        ('{"do": "path", "points": [[0, 0], [0, 9]], "stops": [[0.5, 1]]}', "stops: expected a whole number"),
    ],
)
def test_what_is_no_request(text: str, said: str) -> None:
    with pytest.raises(ProtocolError) as fault:
        parse_request(text)
    assert said in str(fault.value)
    assert len(str(fault.value)) < 400 and "\n" not in str(fault.value)


_anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)
_names = sorted({name for fields in REQUESTS.values() for name in fields})


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(st.sampled_from(_names), _anything), st.sampled_from([*REQUESTS, "other"]))
def test_nothing_but_a_protocol_error_comes_of_any_fields(fields: dict, do: str) -> None:
    try:
        request = parse_request(json.dumps({**fields, "do": do}))
    except ProtocolError:
        return
    assert set(request.fields) == set(REQUESTS[do])
    velocity = request.fields.get("velocity")
    if velocity is not None:
        assert math.hypot(*velocity) <= MAX_SPEED + ROUND_OFF


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.text())
def test_nor_of_any_text(text: str) -> None:
    with pytest.raises(ProtocolError):
        parse_request(text)


def test_a_rate_limit_lets_through_its_rate_and_one_second_at_once() -> None:
    limit = RateLimit(10.0, now=5.0)
    assert [limit.allows(1, 5.0) for _ in range(11)] == [True] * 10 + [False]
    assert limit.allows(1, 5.15) and not limit.allows(1, 5.15)
    assert 28 <= sum(limit.allows(1, 7.0 + i / 50) for i in range(100)) <= 30, "ten, and two seconds' worth"
    assert not limit.allows(11, 100.0), "more than a second's worth never comes through"


def test_limits_are_told_in_full() -> None:
    assert Limits().as_dict()["clients"] == 16 and Limits().as_dict()["record_seconds"] == 300.0
