import zoo


def test_the_table_is_that_of_the_cards():
    assert (zoo.HOME / "README.md").read_text() == zoo.HEAD + zoo.table(), "run python tools/zoo.py"


def test_every_shipped_agent_is_in_it_with_its_success():
    table = zoo.table()
    cards = list((zoo.HOME / "agents").glob("*.json"))
    assert len(cards) >= 2
    for card in cards:
        assert f"**`{card.stem}`**" in table
        assert card.with_suffix(".onnx").exists()
    assert table.count("\n") == 2 + len(cards) + len(list((zoo.HOME / "agents" / "seeds").glob("*.json")))
