"""Training of R and psi, online adaptation, and the weights file."""
