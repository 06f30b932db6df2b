"""Work on many machines with Ray (extra `cluster`). The local engine imports nothing from here."""
