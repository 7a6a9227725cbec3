"""The withheld-effect check: machines with an effect that the diagnosis is not told, and how often it names it."""
