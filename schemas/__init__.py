"""What data means: artefacts with their units and frames, stage parameters, references and the cell file."""
