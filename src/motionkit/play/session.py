"""The world of `motionkit play`: characters, what is wanted of them, and one frame after another.

Nothing here knows of networks or clocks, so the whole of it can be run and tested as fast as it goes.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motionkit import __version__
from motionkit.control.drive import Driver, Wish
from motionkit.control.path import PathPart, make_path
from motionkit.control.steering import steered_type
from motionkit.errors import ControlError
from motionkit.inference.character import CharacterStream, model_first_type
from motionkit.inference.rollout import Noise
from motionkit.models.model import MotionModel
from motionkit.motion.motion import Motion
from motionkit.motion.skeleton import JOINT_NAMES, PARENTS, Skeleton
from motionkit.play.frames import Shown, WorldFrame
from motionkit.play.limits import Limits
from motionkit.play.recording import Recorder
from motionkit.play.requests import Request

PROTOCOL = 1
CONTACT_NAMES = ("left foot", "left toe", "right foot", "right toe")
SPACE_BETWEEN = 120.0  # cm between characters as they are put into the world
PATH_JOINS_WITHIN = 30.0  # cm; a path that begins further away is led up to


class Character:
    """One character of the world and everything its user has asked for."""

    def __init__(
        self, model: MotionModel, number: int, slot: int, body: str, noise: Noise, stream: CharacterStream
    ) -> None:
        """The stream is one for a single character, new or left by another."""
        self.model, self.id, self.slot = model, number, slot
        self.owner: int | None = None
        self.body, self.stream = body, stream
        self.set_noise(noise)
        self.seq = 0
        self.recorder: Recorder | None = None
        # In a row, to the left and right of the first in turn.
        self.place = (SPACE_BETWEEN * ((slot + 1) // 2) * (-1.0) ** slot, 0.0, 0.0)
        self._start(body, self.place)

    def _start(self, body: str, place: tuple[float, float, float]) -> None:
        kind = model_first_type(self.model)
        self.stream.reset(0, body, kind, place)
        self.driver = Driver(self.model, kind)
        self.body = body

    def reset(self) -> None:
        """Stand again where it was put first; a recording goes on."""
        self._start(self.body, self.place)

    def set_body(self, body: str) -> None:
        """Another body at the same place; raises ControlError for an unknown one."""
        x, z, heading = self.stream.ground[0].tolist()
        self._start(body, (x, z, heading))

    def set_noise(self, noise: Noise) -> None:
        """Draw its frames otherwise from now on."""
        self.noise = noise
        self.stream.state.noise = noise

    def follow(self, points: list[tuple[float, float]], kind: str | None, speed: float | None) -> None:
        """Follow a drawn path; raises ControlError if it is no path."""
        x, z = self.stream.ground[0, :2].tolist()
        if math.dist(points[0], (x, z)) > PATH_JOINS_WITHIN:
            points = [(x, z), *points]
        if kind is None:
            kind = steered_type(self.model, (0.0, 100.0 if speed is None else speed), None)
        path = make_path([PathPart(np.array(points, np.float64), kind, speed)])
        self.driver.set_wish(Wish(path=path))

    def step(self, number: int) -> Shown:
        """The next frame; one that went astray in the network's numbers starts anew."""
        made = self.stream.step(self.driver(number, self.stream.ground))
        if not bool(np.isfinite(made.positions).all()):
            self.reset()
            made = self.stream.step(self.driver(number, self.stream.ground))
        rotations, root = made.rotations[0], made.root_positions[0]
        recording = self.recorder is not None and not self.recorder.full
        if self.recorder is not None:
            self.recorder.append(rotations, root)
        return Shown(
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
    """A finished recording of a character."""

    character: int
    owner: int | None
    motion: Motion


class Session:
    """All characters and what their users ask for."""

    def __init__(
        self,
        model: MotionModel,
        body: str = "default",
        limits: Limits | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """body is that of characters for which none is named; raises ControlError if it is unknown."""
        model.character(body)
        self.model, self.body, self.limits = model, body, limits or Limits()
        self.characters: dict[int, Character] = {}
        self.kept: int | None = None  # the character that stays when its client goes
        self.number = 0
        self._clock, self._began = clock, clock()
        self._last_id = 0
        # Of characters that have gone. To make one takes as long as many frames, to reset one does not.
        self._spare: list[CharacterStream] = []
        # Looking all bodies up takes as long as a frame: once, not at every hello.
        self._bodies = [_body_told(name, model.character(name)) for name in model.characters]

    @property
    def time(self) -> float:
        """Seconds since the session began."""
        return self._clock() - self._began

    def step(self, fps: float = 0.0) -> WorldFrame:
        """Move the whole world on by one frame; fps is passed on as the rate frames are made at."""
        began = self._clock()
        self.number += 1
        followed = {c.id for c in self.characters.values() if c.driver.following is not None}
        made = tuple(c.step(self.number) for c in self.characters.values())
        arrived = tuple(one.id for one in made if one.id in followed and one.following is None)
        now = self._clock()
        return WorldFrame(self.number, now - self._began, 1000.0 * (now - began), fps, made, arrived)

    def full(self) -> list[Recorded]:
        """Recordings that have come to their limit, ended now."""
        done = [c for c in self.characters.values() if c.recorder is not None and c.recorder.full]
        return [self._end_recording(character) for character in done]

    # ---- who is there ----

    def join(self, client: int, body: str | None = None) -> Character | None:
        """A character for a client that has just come: the kept one if it is free, a new one, None without room."""
        kept = None if self.kept is None else self.characters.get(self.kept)
        if kept is not None and kept.owner is None:
            kept.owner = client
            return kept
        if len(self.characters) >= self.limits.characters:
            return None
        return self.add(client, body)

    def add(self, client: int | None, body: str | None = None) -> Character:
        """Another character; raises ControlError for an unknown body or a world that is full."""
        if len(self.characters) >= self.limits.characters:
            raise ControlError(f"there is room for {self.limits.characters} characters, all of it is taken")
        taken = {c.slot for c in self.characters.values()}
        slot = next(i for i in range(self.limits.characters) if i not in taken)
        body = body or self.body
        self.model.character(body)
        self._last_id += 1
        stream = self._spare.pop() if self._spare else CharacterStream(self.model, seed=self._last_id)
        character = Character(self.model, self._last_id, slot, body, Noise(), stream)
        character.owner = client
        self.characters[character.id] = character
        return character

    def keep(self) -> Character:
        """A character that is always there, for whoever shows it."""
        character = self.add(None)
        self.kept = character.id
        return character

    def leave(self, client: int) -> None:
        """A client has gone, and its characters with it; a kept one is reset and waits for the next client."""
        for character in [c for c in self.characters.values() if c.owner == client]:
            self._free(character)

    def _free(self, character: Character) -> None:
        if character.id == self.kept:
            character.owner, character.recorder, character.seq = None, None, 0
            character.driver.set_wish(Wish())
        else:
            del self.characters[character.id]
            self._spare.append(character.stream)

    def owned(self, client: int, number: int | None) -> Character:
        """A client's character, its first without a number; raises ControlError if it has no such."""
        mine = [c for c in self.characters.values() if c.owner == client]
        if number is None and mine:
            return mine[0]
        for character in mine:
            if character.id == number:
                return character
        raise ControlError("you have no character" if number is None else f"character {number} is not yours")

    # ---- what they ask for ----

    def obey(self, client: int, request: Request) -> Recorded | None:
        """Do what a client asks for: any request but ping. Answers a recording if one ended.

        Raises:
            ControlError: for what cannot be done; nothing has changed then.
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
                self._check_path(fields["points"])
                character.follow(fields["points"], fields["type"], fields["speed"])
            case "remove":
                self._free(character)
            case "body":
                if character.recorder is not None:
                    raise ControlError("a recording has one body; end it first")
                self.model.character(fields["body"])
                character.set_body(fields["body"])
            case "reset":
                character.reset()
            case "noise":
                character.set_noise(
                    replace(character.noise, kind=fields["kind"], temperature=fields["temperature"])
                )
            case "record":
                return self._record(character, fields["on"])
        character.seq = fields.get("seq", character.seq)
        return None

    def _check_path(self, points: list[tuple[float, float]]) -> None:
        steps = np.diff(np.array(points), axis=0)
        length = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
        if length > self.limits.path_cm:
            raise ControlError(
                f"the path is {length:.0f} cm long, at most {self.limits.path_cm:.0f} are taken"
            )

    def _record(self, character: Character, on: bool) -> Recorded | None:
        if on:
            if character.recorder is not None:
                raise ControlError(f"character {character.id} is being recorded already")
            skeleton = self.model.character(character.body)
            most = int(self.limits.record_seconds * self.model.fps)
            character.recorder = Recorder(skeleton, self.model.fps, most)
            return None
        if character.recorder is None or not character.recorder.frames:
            character.recorder = None
            raise ControlError(f"nothing was recorded of character {character.id}")
        return self._end_recording(character)

    def _end_recording(self, character: Character) -> Recorded:
        assert character.recorder is not None
        motion, character.recorder = character.recorder.motion(), None
        return Recorded(character.id, character.owner, motion)

    # ---- what clients are told ----

    def hello(self, client: int, character: Character | None) -> dict[str, Any]:
        """The event every client gets first."""
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
            "steered": [name for name, kind in model.types.items() if kind.steered],
            "bodies": self._bodies,
            "characters": self.told(),
            "limits": self.limits.told(),
        }

    def told(self) -> list[dict[str, Any]]:
        """Every character as the event `characters` lists it."""
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


def _body_told(name: str, body: Skeleton) -> dict[str, Any]:
    """A body as hello lists it."""
    return {
        "name": name,
        "offsets": [[round(v, 4) for v in row] for row in body.offsets.tolist()],
        "ends": {str(j): [round(v, 4) for v in end] for j, end in body.end_sites.items()},
    }
