"""What the pages of the documentation show: every block of code in them holds, or says why not."""
