"""What no name of the catalogue stands for, modelled all the same: a law, a curve or a map."""
