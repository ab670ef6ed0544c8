"""One job over many recordings: on all cores or a Dask cluster, resumable, with a population."""
