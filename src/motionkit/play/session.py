"""The session of `motionkit play`: characters and their users' requests, one frame after another.

It knows nothing of networks or real time, so tests can run it at full speed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motionkit.control.drive import Driver, Wish
from motionkit.control.path import SHORTEST, PathPart, make_path
from motionkit.control.steering import steered_type
from motionkit.errors import ControlError
from motionkit.inference.character import CharacterStream, model_first_type
from motionkit.inference.noise import Noise
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton
from motionkit.play.frames import CharacterState, WorldFrame
from motionkit.play.limits import Limits
from motionkit.play.recording import Recorder
from motionkit.play.requests import Request
from motionkit.version import __version__

PROTOCOL = 1
CONTACT_NAMES = ("left foot", "left toe", "right foot", "right toe")
SPACE_BETWEEN = 120.0  # cm between start positions
PATH_JOINS_WITHIN = 30.0  # cm; a path that begins further away is extended by a line from the character


class Character:
    """A character and the requests of its user."""

    def __init__(
        self, model: MotionModel, number: int, slot: int, body: str, noise: Noise, stream: CharacterStream
    ) -> None:
        """stream holds one character; it may be new or reused."""
        self.model, self.id, self.slot = model, number, slot
        self.owner: int | None = None
        self.body, self.stream = body, stream
        self.set_noise(noise)
        self.seq = 0
        self.recorder: Recorder | None = None
        # Start positions form a row, alternating to the left and right of the first.
        self.place = (SPACE_BETWEEN * ((slot + 1) // 2) * (-1.0) ** slot, 0.0, 0.0)
        self._start(body, self.place)

    def _start(self, body: str, place: tuple[float, float, float]) -> None:
        kind = model_first_type(self.model)
        self.stream.reset(0, body, kind, place)
        self.driver = Driver(self.model, kind, choice=self.id)
        self.body = body

    def reset(self) -> None:
        """Return to the start position; a recording continues."""
        self._start(self.body, self.place)

    def set_body(self, body: str) -> None:
        """Change the body without moving; raises ControlError if it is unknown."""
        x, z, heading = self.stream.ground[0].tolist()
        self._start(body, (x, z, heading))

    def set_noise(self, noise: Noise) -> None:
        """Change the noise of sampling."""
        self.noise = noise
        self.stream.state.noise = noise

    def follow(
        self,
        points: list[tuple[float, float]],
        kind: str | None,
        speed: float | None,
        stops: Sequence[tuple[int, float]],
        longest: float,
    ) -> None:
        """Follow a drawn path, with stops (point index, seconds); raises ControlError if it is invalid.

        longest is the most in cm that the path may have, with the way to its beginning.
        """
        if stops and stops[-1][0] >= len(points):
            raise ControlError(f"expected stops at points 1 to {len(points) - 1}, found {stops[-1][0]}")
        drawn = sum(map(math.dist, points, points[1:]))
        if drawn < SHORTEST:
            raise ControlError(f"the path is {drawn:.1f} cm long, expected at least {SHORTEST:g} cm")
        x, z = self.stream.ground[0, :2].tolist()
        start = [(x, z)] if math.dist(points[0], (x, z)) > PATH_JOINS_WITHIN else []
        if kind is None:
            kind = steered_type(self.model, (0.0, 100.0 if speed is None else speed), None)
        ends = [(len(start) + number, seconds) for number, seconds in stops]
        points = start + points
        size = sum(map(math.dist, points, points[1:]))
        if size > longest:
            raise ControlError(f"the path is {size:.0f} cm long, at most {longest:.0f} cm are allowed")
        if not ends or ends[-1][0] < len(points) - 1:
            ends.append((len(points) - 1, 0.0))
        begins = [0, *(number + 1 for number, _ in ends)]
        parts = [
            PathPart(np.array(points[begin : end + 1], np.float64), kind, speed, stop)
            for begin, (end, stop) in zip(begins, ends, strict=False)
        ]
        self.driver.set_wish(Wish(path=make_path(parts)))

    def step(self, number: int) -> CharacterState:
        """The next frame; resets the character if its positions are not finite."""
        made = self.stream.step(self.driver(number, self.stream.ground))
        if not bool(np.isfinite(made.positions).all()):
            self.reset()
            made = self.stream.step(self.driver(number, self.stream.ground))
        rotations, root = made.rotations[0], made.root_positions[0]
        recording = self.recorder is not None and not self.recorder.full
        if self.recorder is not None:
            self.recorder.append(rotations, root)
        return CharacterState(
            self.id,
            self.seq,
            self.model.type_id(self.driver.type),
            self.driver.performing is not None,
            self.driver.following,
            recording,
            made.contacts[0],
            float(made.ground[0, 2]),
            root,
            rotations,
            made.positions[0],
        )


@dataclass(frozen=True, eq=False)
class Recorded:
    """A finished recording of a character; format is the requested one, or None."""

    character: int
    owner: int | None
    motion: Motion
    format: str | None = None


class Session:
    """All characters and their users' requests."""

    def __init__(
        self,
        model: MotionModel,
        body: str = "default",
        limits: Limits | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """body is the default of new characters; raises ControlError if it is unknown."""
        model.character(body)
        self.model, self.body, self.limits = model, body, limits or Limits()
        self.characters: dict[int, Character] = {}
        self.kept: int | None = None  # id of the character that remains when its client leaves
        self.number = 0
        self._clock, self._began = clock, clock()
        self._last_id = 0
        # Streams of removed characters, for reuse: creating one takes as long as many frames, resetting one does not.
        self._spare: list[CharacterStream] = []
        # Looking up all bodies takes as long as a frame, so do it once rather than at every hello.
        self._bodies = [_body_info(name, model.character(name)) for name in model.characters]

    @property
    def time(self) -> float:
        """Seconds since the session began."""
        return self._clock() - self._began

    def step(self, fps: float = 0.0) -> WorldFrame:
        """Compute one frame of all characters; fps is reported as the frame rate."""
        began = self._clock()
        self.number += 1
        followed = {c.id for c in self.characters.values() if c.driver.following is not None}
        made = tuple(c.step(self.number) for c in self.characters.values())
        arrived = tuple(one.id for one in made if one.id in followed and one.following is None)
        now = self._clock()
        return WorldFrame(self.number, now - self._began, 1000.0 * (now - began), fps, made, arrived)

    def full(self) -> list[Recorded]:
        """End and return recordings that have reached their maximum length."""
        done = [c for c in self.characters.values() if c.recorder is not None and c.recorder.full]
        return [self._end_recording(character) for character in done]

    # ---- clients and characters ----

    def join(self, client: int, body: str | None = None) -> Character | None:
        """Give a new client a character: the kept one if free, else a new one; None if there is no room."""
        kept = None if self.kept is None else self.characters.get(self.kept)
        if kept is not None and kept.owner is None:
            kept.owner = client
            return kept
        if len(self.characters) >= self.limits.characters:
            return None
        return self.add(client, body)

    def add(self, client: int | None, body: str | None = None) -> Character:
        """Add a character; raises ControlError if the body is unknown or the session is full."""
        if len(self.characters) >= self.limits.characters:
            raise ControlError(f"the world is full: there is room for {self.limits.characters} characters")
        used = {c.slot for c in self.characters.values()}
        slot = next(i for i in range(self.limits.characters) if i not in used)
        body = body or self.body
        self.model.character(body)
        self._last_id += 1
        stream = self._spare.pop() if self._spare else CharacterStream(self.model, seed=self._last_id)
        character = Character(self.model, self._last_id, slot, body, Noise(), stream)
        character.owner = client
        self.characters[character.id] = character
        return character

    def keep(self) -> Character:
        """Add a character that remains without a client, for VMC output."""
        character = self.add(None)
        self.kept = character.id
        return character

    def leave(self, client: int) -> None:
        """Remove a client's characters; a kept one stays at its place with default settings, for the next client."""
        for character in [c for c in self.characters.values() if c.owner == client]:
            self._free(character)

    def _free(self, character: Character) -> None:
        if character.id == self.kept:
            character.owner, character.recorder, character.seq = None, None, 0
            character.set_noise(Noise())
            if character.body != self.body:
                character.set_body(self.body)
            character.driver.set_wish(Wish())
            character.driver.performances.end()
        else:
            del self.characters[character.id]
            self._spare.append(character.stream)

    def owned(self, client: int, number: int | None) -> Character:
        """A client's character by number, by default its first; raises ControlError if it has no such character."""
        mine = [c for c in self.characters.values() if c.owner == client]
        if number is None and mine:
            return mine[0]
        for character in mine:
            if character.id == number:
                return character
        raise ControlError("you have no character" if number is None else f"character {number} is not yours")

    # ---- requests ----

    def obey(self, client: int, request: Request) -> Recorded | None:
        """Carry out any request but ping; returns a recording if one ended.

        Raises:
            ControlError: the request cannot be carried out, and nothing has changed.
        """
        fields = request.fields
        if request.do == "add":
            self.add(client, fields["body"])
            return None
        character = self.owned(client, fields["character"])
        match request.do:
            case "wish":
                character.driver.set_wish(Wish(fields["velocity"], fields["facing"], fields["type"]))
            case "perform":
                character.driver.perform(fields["type"], fields["seconds"], self.number)
            case "path":
                way = {name: fields[name] for name in ("points", "speed", "stops")}
                character.follow(**way, kind=fields["type"], longest=self.limits.path_cm)
            case "remove":
                self._free(character)
            case "body":
                if character.recorder is not None:
                    raise ControlError("the body cannot change during a recording; end the recording first")
                self.model.character(fields["body"])
                character.set_body(fields["body"])
            case "reset":
                character.reset()
            case "noise":
                character.set_noise(
                    replace(character.noise, kind=fields["kind"], temperature=fields["temperature"])
                )
            case "record":
                return self._record(character, fields["on"], fields.get("format"))
        character.seq = fields.get("seq", character.seq)
        return None

    def _record(self, character: Character, on: bool, format: str | None) -> Recorded | None:
        if on:
            if character.recorder is not None:
                raise ControlError(f"character {character.id} is already being recorded")
            skeleton = self.model.character(character.body)
            most = int(self.limits.record_seconds * self.model.fps)
            character.recorder = Recorder(skeleton, self.model.fps, most, format)
            return None
        if character.recorder is None or not character.recorder.frames:
            raise ControlError(f"nothing was recorded of character {character.id}")
        recorded = self._end_recording(character)
        return replace(recorded, format=format or recorded.format)

    def _end_recording(self, character: Character) -> Recorded:
        assert character.recorder is not None
        recorder, character.recorder = character.recorder, None
        return Recorded(character.id, character.owner, recorder.motion(), recorder.format)

    # ---- events ----

    def hello(self, client: int, character: Character | None) -> dict[str, Any]:
        """The first event for a client."""
        model = self.model
        gaits = [(name, kind.gait) for name, kind in model.types.items()]
        return {
            "event": "hello",
            "protocol": PROTOCOL,
            "motionkit": __version__,
            "client": client,
            "character": None if character is None else character.id,
            "fps": model.fps,
            "joints": list(JOINT_NAMES),
            "parents": list(PARENTS),
            "contacts": list(CONTACT_NAMES),
            "types": [
                {
                    "name": kind,
                    "speed": 0.0 if gait is None else round(gait.speed, 2),
                    "facing": 0.0 if gait is None else round(gait.facing, 4),
                    "seconds": round(model.phase_seconds(kind), 4),
                }
                for kind, gait in gaits
            ],
            "steered": [name for name in model.types if model.kind(name).steered],
            "bodies": self._bodies,
            "characters": self.character_list(),
            "limits": self.limits.as_dict(),
        }

    def character_list(self) -> list[dict[str, Any]]:
        """All characters, for the event `characters`."""
        return [
            {
                "id": c.id,
                "body": c.body,
                "owner": c.owner,
                "recording": c.recorder is not None,
                "noise": c.noise.kind,
                "temperature": c.noise.temperature,
            }
            for c in self.characters.values()
        ]


def _body_info(name: str, body: Skeleton) -> dict[str, Any]:
    """A body, for hello."""
    return {
        "name": name,
        "offsets": [[round(v, 4) for v in row] for row in body.offsets.tolist()],
        "ends": {str(j): [round(v, 4) for v in end] for j, end in body.end_sites.items()},
    }
