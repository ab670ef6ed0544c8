"""The version, where every layer may read it; pyproject.toml says the same (a test holds it)."""

VERSION = "0.2.0"
