"""Makes the people that ship in `echoavatar/assets/characters` from the MakeHuman base mesh, and their sheets.

May import `avatar` and below of `echoavatar`. `echoavatar` never imports it. Metres, Y up, facing +Z; colours sRGB.
"""
