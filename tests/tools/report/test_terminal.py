from drd_tools.report.terminal import columns, metres


def test_columns_are_as_wide_as_their_widest_cell_with_text_to_the_left() -> None:
    rows = [("name", "m", "why"), ("a", "12.5", "so"), ("longer", "1")]
    assert columns(rows, text=(0, 2)) == [
        "  name       m  why",
        "  a       12.5  so",
        "  longer     1",
    ]
    assert columns(rows, indent="")[1] == "a       12.5   so"
    assert columns([]) == []


def test_lengths_below_ten_centimetres_are_in_millimetres() -> None:
    assert [metres(v) for v in (0.0123, 0.5, -1e-9)] == ["12.3 mm", "0.5 m", "0 mm"]
    assert metres(1.25, "+") == "+1.25 m"
