"""What a loop on a real robot needs."""
