"""What a run's files say, as pictures, a page and a film. It computes no result; import it only when drawing."""
