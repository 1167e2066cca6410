"""What is published: the source distribution and wheels, built, installed and used."""
