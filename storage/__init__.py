"""The lake: content-addressed artefacts, committed by manifests, in a local folder or an object store."""
