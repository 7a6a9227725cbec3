"""The unknown controller: the gains of a cascade from reference, position and command."""
