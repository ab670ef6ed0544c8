"""How good the time stamps of a CAN log are: per message, per channel, between channels."""
