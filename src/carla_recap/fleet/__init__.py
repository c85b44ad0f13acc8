"""Many recordings: where they are found, and how a question is asked of each of them."""
