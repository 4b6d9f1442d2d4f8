"""The work of a worker process: solves, files, previews."""
