"""What an object's learned dynamics say about the options with it, in seconds and probabilities."""
