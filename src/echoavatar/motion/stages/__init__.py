"""The stages behind the tokenizer's decoder, in the order in which `post` runs them. May import `nn` and below."""
