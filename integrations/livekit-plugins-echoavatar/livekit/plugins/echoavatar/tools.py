"""The avatar's tools as LiveKit function tools, and over RPC if the avatar is in another process."""

import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from livekit import rtc
from livekit.agents.llm import RawFunctionTool, function_tool

from echoavatar.errors import EchoAvatarError
from echoavatar.json_reader import read_json, read_object

RPC_CALL = "echoavatar.call"  # payload {"name": ..., "arguments": {...}}; without a name, the answer is the schemas
Schema = dict[str, Any]
Call = Callable[[str, Mapping[str, Any]], Awaitable[Schema]]


def function_tools(schemas: list[Schema], call: Call) -> list[RawFunctionTool[Any, Any]]:
    """One tool for each schema. A successful call returns nothing, so that the model need not comment on a gesture."""
    return [_tool(schema, call) for schema in schemas]


def _tool(schema: Schema, call: Call) -> RawFunctionTool[Any, Any]:
    async def run(raw_arguments: dict[str, object]) -> str | None:
        result = await call(schema["name"], raw_arguments)
        return None if result.get("status") in ("accepted", "done") else json.dumps(result)

    run.__name__ = schema["name"]
    return function_tool(run, raw_schema=schema)


def answer_calls(room: rtc.Room, schemas: list[Schema], call: Call) -> None:
    """In the avatar's process: carry out the calls of the agent's model."""

    async def handle(data: rtc.RpcInvocationData) -> str:
        try:
            request = read_object(data.payload, "the payload")
        except EchoAvatarError as error:
            return json.dumps({"status": "rejected", "reason": str(error)})
        if not isinstance(request.get("arguments", {}), dict):
            return json.dumps({"status": "rejected", "reason": "ask with a name and arguments"})
        if "name" not in request:
            return json.dumps(schemas)
        return json.dumps(await call(str(request["name"]), request.get("arguments", {})))

    room.local_participant.register_rpc_method(RPC_CALL, handle)


async def ask_for_tools(room: rtc.Room, identity: str) -> list[RawFunctionTool[Any, Any]]:
    """In the agent's process: fetch the tools of an avatar in the room."""

    async def perform(payload: Schema) -> Any:
        answer = await room.local_participant.perform_rpc(
            destination_identity=identity, method=RPC_CALL, payload=json.dumps(payload)
        )
        return read_json(answer, "the answer")

    async def call(name: str, arguments: Mapping[str, Any]) -> Schema:
        result: Schema = await perform({"name": name, "arguments": dict(arguments)})
        return result

    return function_tools(await perform({}), call)
