"""What recordings show directly, beside the balance: rotor against rack, twist, rest, reversals."""
