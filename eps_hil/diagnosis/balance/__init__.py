"""The torque balance as a residual of the model's parameters and of every effect; its fit."""
