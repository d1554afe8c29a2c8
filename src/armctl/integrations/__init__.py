"""Optional connections to other software: each can be imported alone, and loads its library when it is used."""
