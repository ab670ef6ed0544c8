"""What a diagnosis is worth beside one that had known the truth; after the seal was opened."""
