"""An identification programme on the bus: cells of speed and preload, driven, recorded, resumed."""
