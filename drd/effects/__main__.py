"""Writes CATALOGUE.md anew: `python -m drd.effects`."""

from pathlib import Path

from drd.effects.table import markdown

if __name__ == "__main__":
    Path(__file__).with_name("CATALOGUE.md").write_text(markdown())
