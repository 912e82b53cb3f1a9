"""What is stored: weight files and the baselines' files, with what each was made from."""
