"""What was asked, as it is kept with what was made."""

from flows.requests import Diagnose, Monitor


def test_a_request_comes_back_from_its_record(tmp_path):
    asked = Diagnose(("a", "b"), robot="irb140", held_out=("c",), declared=("viscous",))
    kept = asked.to_record()
    assert kept["step"] == "diagnose"
    assert Diagnose.from_record(kept, tmp_path) == Diagnose(
        ("a", "b"),
        robot="irb140",
        held_out=("c",),
        declared=("viscous",),
        store=tmp_path,
    )


def test_where_things_lie_is_no_part_of_a_record():
    kept = Monitor("irb140", ("a",), store="/somewhere").to_record()
    assert "store" not in kept
