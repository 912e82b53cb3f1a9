"""What is learned: autoencoder, recurrent networks, recall heads, their training and weights. Never imports Drake."""
