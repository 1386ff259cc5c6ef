"""The world of `motionkit play`, without network or real time."""

from __future__ import annotations

import gc
import math
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motionkit.cli import outputs
from motionkit.errors import ControlError
from motionkit.export.formats import WRITERS, read_motion
from motionkit.features.control import Controls
from motionkit.inference.character import CharacterFrame
from motionkit.models.bundled import load_bundled_model
from motionkit.models.model import MotionModel
from motionkit.motion.bvh import bvh_to_motion, read_bvh
from motionkit.motion.kinematics import motion_kinematics
from motionkit.motion.rotations import quat_angle
from motionkit.play.frames import WorldFrame
from motionkit.play.limits import Limits
from motionkit.play.recording import FORMATS, Recordings, file_bytes
from motionkit.play.requests import Request, parse_request
from motionkit.play.session import Recorded, Session


def ask(session: Session, client: int, do: str, **fields: Any) -> Recorded | None:
    import json

    return session.obey(client, parse_request(json.dumps({"do": do, **fields})))


def play(session: Session, frames: int) -> list[WorldFrame]:
    return [session.step() for _ in range(frames)]


@pytest.fixture
def session(tiny_model: MotionModel) -> Session:
    return Session(tiny_model)


def test_everyone_gets_a_character_and_takes_it_away_again(session: Session) -> None:
    one, two = session.join(1), session.join(2)
    assert one is not None and two is not None and one.id != two.id
    assert one.place[0] != two.place[0], "not inside each other"
    assert [c.id for c in play(session, 1)[0].characters] == [one.id, two.id]
    session.leave(1)
    assert [c.id for c in play(session, 1)[0].characters] == [two.id]
    again = session.join(3)
    assert again is not None and again.place == one.place, "the free spot is used again, the id is not"
    assert again.id not in (one.id, two.id)


def test_characters_pick_recordings_by_their_ids(tiny_model: MotionModel) -> None:
    def choices() -> list[int]:
        session = Session(tiny_model)
        one = session.join(1)
        assert one is not None
        session.leave(1)
        some = [session.add(1) for _ in range(3)]
        some[0].reset()
        assert [character.driver.choice for character in some] == [character.id for character in some]
        return [character.driver.choice for character in some]

    assert choices() == choices() and len(set(choices())) == 3


def test_who_comes_after_another_has_nothing_of_it(session: Session, tiny_model: MotionModel) -> None:
    one = session.join(1)
    assert one is not None
    ask(session, 1, "noise", kind="mean", temperature=2)
    ask(session, 1, "body", body=list(tiny_model.characters)[-1])
    ask(session, 1, "wish", velocity=[300, 0], type="running", seq=9)
    play(session, 40)
    session.leave(1)
    two = session.join(2)
    assert two is not None and two.stream is one.stream, "what took long to make is used again"
    fresh = Session(tiny_model).join(3)
    assert fresh is not None
    assert (two.noise, two.body, two.seq, two.recorder) == (fresh.noise, fresh.body, 0, None)
    assert two.stream.state.noise == fresh.noise and np.array_equal(two.stream.ground, fresh.stream.ground)
    shown, other = two.step(0), fresh.step(0)
    assert np.allclose(np.array(shown.positions), np.array(other.positions), atol=2.0), "but for chance"


def test_a_full_world_takes_watchers_only(tiny_model: MotionModel) -> None:
    session = Session(tiny_model, limits=Limits(characters=2))
    assert session.join(1) and session.join(2)
    assert session.join(3) is None
    with pytest.raises(ControlError, match="room for 2 characters"):
        ask(session, 3, "add")
    with pytest.raises(ControlError, match="you have no character"):
        ask(session, 3, "wish")
    ask(session, 1, "remove")
    ask(session, 3, "add", body="default")
    assert len(session.characters) == 2


def test_nobody_steers_what_is_not_theirs(session: Session) -> None:
    one, _ = session.join(1), session.join(2)
    assert one is not None
    for request in ({"do": "wish"}, {"do": "remove"}, {"do": "reset"}, {"do": "record", "on": True}):
        with pytest.raises(ControlError, match=f"character {one.id} is not yours"):
            ask(session, 2, **request, character=one.id)


def test_a_kept_character_waits_for_the_next_client(session: Session) -> None:
    kept = session.keep()
    assert session.join(1) is kept and session.join(2) is not kept
    ask(session, 1, "wish", velocity=[0, 200])
    ask(session, 1, "record", on=True)
    session.leave(1)
    assert kept.owner is None and kept.recorder is None
    assert kept.driver.wish.velocity == (0.0, 0.0), "it stands until somebody comes"
    assert session.join(3) is kept


def test_a_kept_character_is_for_the_next_client_as_it_was_at_first(session: Session) -> None:
    kept = session.keep()
    session.join(1)
    other = next(body for body in session.model.characters if body != kept.body)
    first = kept.body, kept.noise
    ask(session, 1, "noise", temperature=2.0)
    ask(session, 1, "body", body=other)
    assert (kept.body, kept.noise) != first
    session.leave(1)
    assert (kept.body, kept.noise) == first


def test_a_kept_character_ends_its_dance_and_forgets_what_waits() -> None:
    session = Session(load_bundled_model())
    kept = session.keep()
    session.join(1)
    ask(session, 1, "perform", type="dance-salsa", seconds=60)
    play(session, 10)
    ask(session, 1, "perform", type="cartwheel")
    session.leave(1)
    assert not any(frame.characters[0].performing for frame in play(session, 30))
    session.join(2)
    ask(session, 2, "perform", type="cartwheel")
    play(session, 20)
    session.leave(2)
    flips = [frame.characters[0].performing for frame in play(session, 300)]
    assert flips[0] and not flips[-1], "a flip is shown to its end"
    assert kept.driver.performing is None


def test_frames_carry_what_was_asked(session: Session, tiny_model: MotionModel) -> None:
    character = session.join(1)
    assert character is not None
    ask(session, 1, "wish", velocity=[0, 300], type="running", seq=77)
    shown = play(session, 30)[-1].characters[0]
    assert (shown.seq, tiny_model.type_names[shown.type]) == (77, "running")
    ask(session, 1, "perform", type="cartwheel", seq=78)
    shown = play(session, 30)[-1].characters[0]
    assert shown.performing and shown.seq == 78 and tiny_model.type_names[shown.type] == "cartwheel"
    assert shown.rotations.shape == (23, 4) and shown.positions.shape == (23, 3)
    assert np.allclose(np.linalg.norm(shown.rotations, axis=-1), 1.0, atol=1e-4)
    assert np.allclose(shown.positions[0], shown.root, atol=1e-3)


def test_the_first_frame_after_a_wish_is_another(tiny_model: MotionModel) -> None:
    one, two = Session(tiny_model), Session(tiny_model)
    for session in (one, two):
        session.join(1)
        play(session, 10)
    ask(one, 1, "wish", velocity=[0, 300], type="running")
    first, same = one.step().characters[0], two.step().characters[0]
    assert not np.array_equal(first.rotations, same.rotations), "no frame is waiting in between"


def test_frames_count_without_a_leap(session: Session) -> None:
    session.join(1)
    assert [frame.number for frame in play(session, 5)] == [1, 2, 3, 4, 5]


def test_a_path_ends_with_an_arrival(session: Session) -> None:
    character = session.join(1)
    assert character is not None
    ask(session, 1, "path", points=[[0, 0], [0, 40]], type="walking", speed=300)
    assert play(session, 1)[0].characters[0].following is not None
    character.driver.follower.place.words.arc = 40.0  # the tiny model cannot walk there by itself
    character.stream.state.frame.ground[0, 1] = 40.0
    assert play(session, 1)[0].arrived == (character.id,)
    assert play(session, 1)[0].arrived == ()


def test_a_path_that_begins_elsewhere_is_led_up_to(session: Session) -> None:
    character = session.join(1)
    assert character is not None
    ask(session, 1, "path", points=[[300, 0], [300, 200]])
    path = character.driver.wish.path
    assert path is not None
    assert np.allclose(path.points[0], character.stream.ground[0, :2])
    assert path.length == pytest.approx(500.0, abs=4.0)


def test_a_path_with_stops_is_made_of_parts(session: Session) -> None:
    character = session.join(1)
    assert character is not None
    ask(
        session, 1, "path", points=[[0, 0], [0, 100], [0, 200], [50, 300]], stops=[[1, 2.0], [3, 1]], speed=90
    )
    path = character.driver.wish.path
    assert path is not None
    assert [(part.points.tolist(), part.speed, part.stop) for part in path.parts] == [
        ([[0, 0], [0, 100]], 90.0, 2.0),
        ([[0, 200], [50, 300]], 90.0, 1.0),
    ]
    assert 2.0 * np.bincount(path.part).cumsum() == pytest.approx([100.0, path.length], abs=2.1)
    ask(session, 1, "path", points=[[300, 0], [300, 200]], stops=[[1, 2.0]])
    path = character.driver.wish.path
    assert path is not None and len(path.parts) == 1 and path.parts[0].stop == 2.0


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({"do": "path", "points": [[0, 0], [0, 90]], "stops": [[2, 1]]}, "stops at points 1 to 1, found 2"),
        ({"do": "wish", "type": "flying"}, "unknown motion type 'flying'"),
        ({"do": "perform", "type": "walkin"}, "did you mean 'walking'"),
        ({"do": "path", "points": [[0, 0], [0, 1]]}, "expected at least 4 cm"),
        ({"do": "path", "points": [[500, 0], [500, 1]]}, "the path is 1.0 cm long, expected at least 4 cm"),
        ({"do": "path", "points": [[0, 0], [0, 60000]]}, "at most 50000 cm are allowed"),
        ({"do": "path", "points": [[900000, 0], [900000, 100]]}, "at most 50000 cm are allowed"),
        ({"do": "path", "points": [[0, 0], [0, 100]], "type": "flying"}, "unknown motion type"),
        ({"do": "body", "body": "giant"}, "unknown character 'giant'"),
        ({"do": "add", "body": "giant"}, "unknown character 'giant'"),
        ({"do": "record", "on": False}, "nothing was recorded"),
        ({"do": "remove", "character": 99}, "character 99 is not yours"),
    ],
)
def test_what_cannot_be_done_changes_nothing(session: Session, request_: dict, said: str) -> None:
    character = session.join(1)
    assert character is not None
    before = session.character_list(), character.driver.wish, character.seq
    with pytest.raises(ControlError, match=said):
        ask(session, 1, **request_)
    assert (session.character_list(), character.driver.wish, character.seq) == before
    play(session, 2)


def test_noise_and_body_can_be_changed(session: Session, tiny_model: MotionModel) -> None:
    character = session.join(1)
    assert character is not None
    ask(session, 1, "noise", kind="mean", temperature=0)
    assert session.character_list()[0]["noise"] == "mean"
    play(session, 20)
    place = character.stream.ground[0].tolist()
    other = list(tiny_model.characters)[-1]
    ask(session, 1, "body", body=other)
    assert session.character_list()[0]["body"] == other
    assert character.stream.ground[0].tolist() == pytest.approx(place, abs=1e-3)


def test_a_reset_character_stands_where_it_was_put(session: Session) -> None:
    session.join(1)
    ask(session, 1, "add")
    second = list(session.characters.values())[1]
    ask(session, 1, "wish", character=second.id, velocity=[300, 0])
    play(session, 40)
    ask(session, 1, "reset", character=second.id)
    assert second.stream.ground[0].tolist() == pytest.approx(second.place)
    assert second.driver.wish.velocity == (0.0, 0.0)


def test_a_character_whose_numbers_go_astray_starts_anew(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    character = session.join(1)
    assert character is not None
    play(session, 3)
    step, calls = character.stream.step, []

    def astray(asked: Controls) -> CharacterFrame:
        made = step(asked)
        calls.append(1)
        return replace(made, positions=made.positions * math.nan) if len(calls) == 1 else made

    monkeypatch.setattr(character.stream, "step", astray)
    shown = play(session, 1)[0].characters[0]
    assert np.isfinite(shown.positions).all() and np.isfinite(shown.rotations).all()
    assert np.isfinite(play(session, 3)[-1].characters[0].root).all()


def test_a_recording_holds_the_frames_that_were_sent(session: Session, tmp_path: Path) -> None:
    session.join(1)
    ask(session, 1, "wish", velocity=[0, 150])
    play(session, 5)
    ask(session, 1, "record", on=True)
    sent = [frame.characters[0] for frame in play(session, 40)]
    assert all(shown.recording for shown in sent)
    recorded = ask(session, 1, "record", on=False)
    assert recorded is not None and not play(session, 1)[0].characters[0].recording
    file = tmp_path / "recorded.bvh"
    file.write_bytes(file_bytes(recorded.motion))
    motion = bvh_to_motion(read_bvh(file))
    assert len(motion) == 40 and motion.fps == 60.0
    rotations = np.stack([shown.rotations for shown in sent])
    roots = np.stack([shown.root for shown in sent])
    assert float(quat_angle(motion.local_rotations, rotations).max()) < 1e-3
    assert np.allclose(motion.root_positions, roots, atol=1e-4)


def test_recordings_have_every_format(session: Session, tmp_path: Path) -> None:
    assert {"fbx", *FORMATS} == {ending.removeprefix(".") for ending in WRITERS} == set(outputs.FORMATS)
    session.join(1)
    ask(session, 1, "record", on=True)
    play(session, 8)
    recorded = ask(session, 1, "record", on=False, format="glb")
    assert recorded is not None and recorded.format == "glb"
    for name in set(FORMATS) - {"vrm"}:  # which takes an avatar
        (tmp_path / f"a.{name}").write_bytes(file_bytes(recorded.motion, format=name))
    for name in ("bvh", "glb"):
        again = read_motion(tmp_path / f"a.{name}")
        assert len(again) == 8 and np.allclose(
            motion_kinematics(again)[1], motion_kinematics(recorded.motion)[1], atol=0.01
        )
    assert (tmp_path / "a.csv").read_text().count("\n") == 9


def test_a_recording_ends_at_its_limit(tiny_model: MotionModel) -> None:
    session = Session(tiny_model, limits=Limits(record_seconds=0.5))
    session.join(1)
    ask(session, 1, "record", on=True)
    with pytest.raises(ControlError, match="already being recorded"):
        ask(session, 1, "record", on=True)
    play(session, 29)
    assert session.full() == []
    play(session, 5)
    (done,) = session.full()
    assert len(done.motion) == 30 and done.format is None and session.full() == []
    ask(session, 1, "record", on=True, format="glb")
    play(session, 35)
    assert [each.format for each in session.full()] == ["glb"]


def test_only_the_newest_recordings_are_kept() -> None:
    store = Recordings(most=2, most_bytes=1000)
    tokens = [store.add(bytes([n]) * 10) for n in range(3)]
    assert [store.get(token) for token in tokens] == [None, b"\x01" * 10, b"\x02" * 10]
    last = store.add(b"x" * 990)
    assert store.get(tokens[1]) is None and store.get(last) is not None
    huge = store.add(b"x" * 5000)
    assert store.get(huge) is not None, "the newest is there even if it is too large"
    assert len(set(tokens)) == 3 and min(map(len, tokens)) >= 20


def test_hello_tells_bodies_and_types(session: Session, tiny_model: MotionModel) -> None:
    hello = session.hello(5, None)
    assert hello["protocol"] == 1 and hello["character"] is None and hello["client"] == 5
    assert len(hello["joints"]) == len(hello["parents"]) == 23
    assert [kind["name"] for kind in hello["types"]] == list(tiny_model.types)
    assert {body["name"] for body in hello["bodies"]} == set(tiny_model.characters)
    body = hello["bodies"][0]
    offsets = tiny_model.character(body["name"]).offsets
    assert np.allclose(np.array(body["offsets"]), offsets, atol=1e-3)


def random_request(generator: random.Random, types: tuple[str, ...]) -> Request:
    pick = generator.random()
    kind = generator.choice([None, *types])
    speed = generator.choice([0, 0, 120, 300, 800])
    way = generator.uniform(-3.2, 3.2)
    if pick < 0.6:
        velocity = None if pick < 0.05 else (speed * math.sin(way), speed * math.cos(way))
        facing = generator.choice([None, way + 1])
        wish = {"velocity": velocity, "facing": facing, "type": kind, "seq": generator.randrange(2**32)}
        return Request("wish", {"character": None, **wish})
    fields: dict[str, Any] = {"character": None}
    if pick < 0.75:
        return Request("perform", {**fields, "type": generator.choice(types), "seconds": 1.0, "seq": 1})
    if pick < 0.85:
        points = [(generator.uniform(-400, 400), generator.uniform(-400, 400)) for _ in range(9)]
        stops = [(generator.randrange(1, 9), 0.5)]
        asked = {"points": points, "type": kind, "speed": None, "stops": stops, "seq": 2}
        return Request("path", {**fields, **asked})
    if pick < 0.9:
        noise = {"kind": generator.choice(["mean", "sample", "correlated"]), "temperature": 1.0}
        return Request("noise", {**fields, **noise})
    if pick < 0.94:
        return Request("record", {**fields, "on": generator.random() < 0.5})
    if pick < 0.96:
        return Request("reset", fields)
    if pick < 0.98:
        return Request("add", {"body": "default"})
    return Request("remove", fields)


def soak(session: Session, seconds: float) -> int:
    """Send random requests of two clients that come and go; returns the frames made."""
    generator = random.Random(3)
    for client in (1, 2):
        session.join(client)
    frames = int(seconds * 60)
    for number in range(frames):
        for client in (1, 2):
            if generator.random() < 0.05:
                try:
                    session.obey(client, random_request(generator, session.model.type_names))
                except ControlError:
                    pass
        if generator.random() < 0.005:
            session.leave(2)
            session.join(2)
        frame = session.step()
        for shown in frame.characters:
            assert np.isfinite(shown.positions).all() and np.isfinite(shown.rotations).all()
        session.full()
        if number % 600 == 599:
            gc.collect()
    return frames


def objects() -> int:
    gc.collect()
    return len(gc.get_objects())


def resident_bytes() -> int:
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("the memory of a process is read from /proc, which this system lacks")
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) * 1024


def few_characters(model: MotionModel) -> Session:
    return Session(model, limits=Limits(characters=2, record_seconds=5.0))


def test_twenty_seconds_of_random_requests_leave_nothing_behind(tiny_model: MotionModel) -> None:
    session = few_characters(tiny_model)
    soak(session, 2)  # caches fill
    for client in (1, 2):
        session.leave(client)
    before = objects()
    soak(session, 20)
    for client in (1, 2):
        session.leave(client)
    assert session.characters == {} and objects() - before < 200


@pytest.mark.slow
def test_ten_minutes_of_random_requests_do_not_grow(tiny_model: MotionModel) -> None:
    session = few_characters(tiny_model)
    soak(session, 60)
    before = resident_bytes()
    assert soak(session, 600) == 36000
    assert resident_bytes() - before < 30e6
