"""The catalogue of physics that a rig may have and a model may lack: ONE FILE PER EFFECT.

Each file but ``effect.py``, ``catalogue.py`` and ``added.py`` defines one ``EFFECT`` (CONTRACT 8).
Adding an effect is adding a file: the catalogue finds it, and the compiled simulator, the
estimator and the model file's reader know it from then on.
"""
