"""The catalogue of effects that a nominal drive leaves out (docs/effects.md)."""
