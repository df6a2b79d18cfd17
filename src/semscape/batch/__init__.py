"""Many specimens: run each, lose none, and go on where a batch was interrupted."""
