"""Makes the character that ships in `echoavatar/assets`, and the sheet of its face shapes.

May import `avatar` and below of `echoavatar`. `echoavatar` never imports it. Metres, Y up, facing +Z; colours sRGB.
"""
