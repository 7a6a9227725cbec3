"""The withheld-effect check: machines with an effect that is hidden from the diagnosis, and how often it names it."""
