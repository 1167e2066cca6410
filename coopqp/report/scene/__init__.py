"""What the playback of the page draws."""
