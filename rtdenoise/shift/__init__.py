"""How far light moves otherwise than its surfaces, in mirrors and behind glass: history is looked up there."""
