/** `<EchoAvatar server="...">` for React: the attributes of `<echo-avatar>` as props, its events as callbacks, the element as ref. */

import { type CSSProperties, createElement, forwardRef, useEffect, useImperativeHandle, useLayoutEffect, useRef } from "react";
import type { EchoAvatarElement, EchoAvatarEvents } from "./element.js";
import "./element.js";

export interface EchoAvatarProps {
  readonly server?: string | undefined;
  readonly token?: string | undefined;
  readonly character?: string | undefined;
  readonly view?: EchoAvatarElement["view"] | undefined;
  readonly light?: EchoAvatarElement["light"] | undefined;
  readonly mode?: "free" | "in-place" | "upper-body" | undefined;
  readonly seed?: number | undefined;
  readonly watch?: string | undefined;
  readonly muted?: boolean | undefined;
  readonly id?: string | undefined;
  readonly className?: string | undefined;
  readonly style?: CSSProperties | undefined;
  readonly onReady?: ((event: EchoAvatarEvents["ready"]) => void) | undefined;
  readonly onState?: ((event: EchoAvatarEvents["state"]) => void) | undefined;
  readonly onAction?: ((event: EchoAvatarEvents["action"]) => void) | undefined;
  readonly onError?: ((event: EchoAvatarEvents["error"]) => void) | undefined;
}

const ATTRIBUTES = ["server", "token", "character", "view", "light", "mode", "seed", "watch"] as const;
// Before the element opens its session, which is at the end of the task in which it is put into the page.
const useEarlyEffect = typeof document === "undefined" ? useEffect : useLayoutEffect;

export const EchoAvatar = forwardRef<EchoAvatarElement, EchoAvatarProps>(function EchoAvatar(props, ref) {
  const own = useRef<EchoAvatarElement>(null);
  const latest = useRef(props);
  useImperativeHandle(ref, () => own.current!, []);
  // React 18 sets attributes of such an element and 19 its properties; these are set alike in both.
  useEarlyEffect(() => {
    latest.current = props;
    for (const name of ATTRIBUTES) {
      const value = props[name];
      if (value === undefined) own.current!.removeAttribute(name);
      else own.current!.setAttribute(name, String(value));
    }
    own.current!.muted = props.muted ?? false;
  });
  useEarlyEffect(() => {
    const element = own.current!;
    const stopping = new AbortController();
    const options = { signal: stopping.signal };
    element.addEventListener("ready", (event) => latest.current.onReady?.(event), options);
    element.addEventListener("state", (event) => latest.current.onState?.(event), options);
    element.addEventListener("action", (event) => latest.current.onAction?.(event), options);
    element.addEventListener("error", (event) => latest.current.onError?.(event), options);
    return () => stopping.abort();
  }, []);
  const { id, className, style } = props;
  return createElement("echo-avatar", { ref: own, id, class: className, style });
});
