"""Services that say why nothing could be done."""

from __future__ import annotations

from hysteresis_ros.errors import HysteresisError


def answered(serve):
    """Return a service that says why nothing could be done."""

    def answer(request, response):
        try:
            return serve(request, response)
        except HysteresisError as error:
            response.success, response.message = False, str(error)
            return response

    return answer
