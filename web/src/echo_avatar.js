// The element as a server serves it: one that names no server belongs to this one.
import { EchoAvatarElement } from "@echoavatar/client/element";

EchoAvatarElement.home = new URL(/* @vite-ignore */ "..", import.meta.url).href;
export { EchoAvatarElement };
