// For the viewer: an exported page runs three.js before it.
module.exports = globalThis.echoavatarThree;
