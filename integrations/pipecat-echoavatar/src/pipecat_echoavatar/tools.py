"""The avatar's tools in Pipecat's forms. All are silent: the model need not comment on a gesture's result."""

from collections.abc import Awaitable, Callable

from pipecat.adapters.llm.schemas.direct_function import tool_options
from pipecat.adapters.llm.schemas.function_schema import FunctionSchema
from pipecat.frames.frames import FunctionCallResultProperties
from pipecat.services.llm_service import FunctionCallParams

from echoavatar.agents.integrations import AvatarTools

DirectFunction = Callable[..., Awaitable[None]]


def function_schemas(tools: AvatarTools) -> list[FunctionSchema]:
    """The avatar's schemas, enums included, each with its handler."""
    return [
        FunctionSchema(
            name=schema["name"],
            description=schema["description"],
            properties=schema["parameters"].get("properties", {}),
            required=schema["parameters"].get("required", []),
            handler=_handler(tools),
        )
        for schema in tools.schemas
    ]


def direct_functions(tools: AvatarTools) -> list[DirectFunction]:
    """The tools as direct functions. Pipecat reads their signatures, which cannot list values; docstrings list them."""

    async def send_action(params: FunctionCallParams, action: str, intensity: float = 1.0, hold: float = 0.0) -> None:
        given = {"action": action, "intensity": intensity, "hold": hold or None}
        await _answer(params, await tools.call("send_action", given))

    async def set_manner(params: FunctionCallParams, liveliness: float) -> None:
        await _answer(params, await tools.call("set_manner", {"liveliness": liveliness}))

    async def play_music(params: FunctionCallParams, title: str = "") -> None:
        await _answer(params, await tools.call("play_music", {"title": title or None}))

    async def stop_music(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call("stop_music", {}))

    async def list_actions(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call("list_actions", {}))

    known = {schema["name"]: schema for schema in tools.schemas}
    functions = []
    for function in (send_action, set_manner, play_music, stop_music, list_actions):
        schema = known.get(function.__name__)
        if schema is not None:
            function.__doc__ = _docstring(schema["description"], schema["parameters"].get("properties", {}))
            functions.append(tool_options(function, cancel_on_interruption=False))
    return functions


def _docstring(description: str, properties: dict[str, dict[str, object]]) -> str:
    lines = [description]
    if properties:
        lines += ["", "Args:"]
    for name, schema in properties.items():
        choices = schema.get("enum")
        one_of = f" One of: {', '.join(map(str, choices))}." if isinstance(choices, list) else ""
        lines.append(f"    {name}: {schema.get('description', '')}{one_of}")
    return "\n".join(lines)


def _handler(tools: AvatarTools) -> Callable[[FunctionCallParams], Awaitable[None]]:
    async def handle(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call(params.function_name, params.arguments))

    handler: Callable[[FunctionCallParams], Awaitable[None]] = tool_options(handle, cancel_on_interruption=False)
    return handler


async def _answer(params: FunctionCallParams, result: dict[str, object]) -> None:
    """Return the result to the model, and ask the model to speak only if the call failed or returns information."""
    is_silent = result.get("status") in ("accepted", "done")
    properties = FunctionCallResultProperties(run_llm=False) if is_silent else None
    await params.result_callback(result, properties=properties)
