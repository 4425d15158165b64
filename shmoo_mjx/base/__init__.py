"""What every part uses: files, guards of input, progress, seeds, versions."""
