from __future__ import annotations

import json

from motionkit.lab.scoreboard.report import Goal, Scoreboard, Section, Table, verdict


def test_goals_are_reached_within_their_limits() -> None:
    assert Goal("a", 0.95, "", 0.95, None).reached is True
    assert Goal("a", 0.94, "", 0.95, None).reached is False
    assert Goal("a", 1.06, "", 0.95, 1.05).reached is False
    assert Goal("a", 0.4, "", None, 0.5).reached is True
    assert Goal("a", None, "", 0.5).reached is None
    assert [verdict(Goal("a", v, "", 1.0)) for v in (1.0, 0.5, None)] == ["reached", "missed", "not measured"]


def test_a_scoreboard_reads_as_markdown_and_json() -> None:
    table = Table("Numbers", ("name", "value", "ok"), [("a|b", 1234.5, True), ("c", 0.12345, None)])
    goal = Goal("speed", 0.7, "≤ 0.5", None, 0.5, "seen")
    board = Scoreboard({"seeds": 3}, [Section("walk", "Walking", [table], [goal], ["a note"], 1.23)])
    text = board.markdown()
    assert "| walk | speed | 0.7 | ≤ 0.5 | missed | seen |" in text
    assert "| a\\|b | 1234 | yes |" in text and "| c | 0.123 |  |" in text
    assert "- seeds: 3" in text and "- a note" in text
    value = json.loads(json.dumps(board.as_dict()))
    assert value["seeds"] == 3
    assert value["sections"][0]["goals"][0]["reached"] is False
    assert value["sections"][0]["tables"][0]["rows"][0] == {"name": "a|b", "value": 1234.5, "ok": True}
