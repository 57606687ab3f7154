"""Pictures of plans and results, from arrays to PNG bytes and page fragments. Nothing here writes files."""
