"""The trained models, as they run without torch: sound, codes of clips, generator, face.

May import `motion`, `nn` and below. Inside: `tokens` serve `generator`; `face` gets the sound that the codec gets.
Their torch modules are in echoavatar-lab.
"""
