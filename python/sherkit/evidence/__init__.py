"""Evidence: a run as rows over noise, everything that may be missing as columns, by how much the readings favour it."""
