"""A study that goes on from what it has."""

from diffdrive.errors import LogError
from experiments.studies.resumed import resumed


def test_what_is_there_is_not_studied_again_and_what_fails_is_said(tmp_path, capsys):
    studied = []

    def study(name):
        studied.append(name)
        if name == "broken":
            raise LogError("has no rows")
        return {"case": name, "size": len(name)}

    out = tmp_path / "lines.jsonl"
    assert [one["case"] for one in resumed(out, ["a", "broken", "bb"], study)] == ["a", "bb"]
    assert "broken: has no rows" in capsys.readouterr().out
    assert list(resumed(out, ["a", "bb", "ccc"], study))[-1] == {"case": "ccc", "size": 3}
    assert studied == ["a", "broken", "bb", "ccc"]
